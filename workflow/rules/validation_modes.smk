# The frequencies of known bodies, solved and compared. Not part of `all`.


rule validation_modes:
    input:
        meshes=paths.validation_meshes,
    output:
        record=paths.validation_comparison,
    log:
        paths.log("validation_modes", "body"),
    conda:
        "../../envs/fem.yaml"
    container:
        image("fem")
    threads: 1
    resources:
        mem_mb=memory("solver"),
        runtime=minutes("solver"),
    params:
        version=VERSIONS["validation_modes"],
        solver=[VERSIONS[stage] for stage in ("basis", "modes")],
    message:
        "{wildcards.body}: frequencies against the known ones"
    shell:
        "vibraverse validation_modes "
        "--object {wildcards.body} "
        "--meshes {input.meshes:q} "
        "--record {output.record:q} "
        "--threads {threads} > {log:q} 2>&1"
