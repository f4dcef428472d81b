# The impact sounds of all materials of a body.


rule audio:
    input:
        **targets.struck(plan),
        modes=paths.modes,
    output:
        sounds=directory(paths.sounds),
    log:
        paths.log("audio", "object", "solidity"),
    conda:
        "../../envs/fem.yaml"
    container:
        image("fem")
    threads: 1
    resources:
        mem_mb=memory("light"),
        runtime=minutes("light"),
    params:
        options=plan.options("audio"),
        version=VERSIONS["audio"],
    message:
        "{wildcards.object}, {wildcards.solidity}: impact sounds"
    shell:
        "vibraverse audio "
        "--object {wildcards.object} --solidity {wildcards.solidity} "
        "--modes {input.modes:q} "
        f"{targets.struck_argument(plan)} "
        "--sounds {output.sounds:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
