# The material-independent modal basis: the costly solve, once per body.


rule basis:
    input:
        tets=paths.tets,
    output:
        basis=paths.basis,
    log:
        paths.log("basis", "object", "solidity"),
    conda:
        "../../envs/fem.yaml"
    container:
        image("fem")
    threads: 1
    resources:
        mem_mb=memory("solver"),
        runtime=minutes("solver"),
    params:
        options=plan.options("basis"),
        version=VERSIONS["basis"],
    message:
        "{wildcards.object}, {wildcards.solidity}: modal basis"
    shell:
        "vibraverse basis "
        "--object {wildcards.object} --solidity {wildcards.solidity} "
        "--tets {input.tets:q} "
        "--basis {output.basis:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
