# Meshes of bodies with known frequencies, by the same code as for every object. Not part of `all`.


rule validation_meshes:
    output:
        meshes=paths.validation_meshes,
    log:
        paths.log("validation_meshes", "body"),
    conda:
        "../../envs/geometry.yaml"
    container:
        image("geometry")
    threads: 1
    resources:
        mem_mb=memory("geometry"),
        runtime=minutes("geometry"),
    params:
        version=VERSIONS["validation_meshes"],
        mesher=[VERSIONS[stage] for stage in ("clean", "hollow", "tets")],
    message:
        "{wildcards.body}: meshes of the validation"
    shell:
        "vibraverse validation_meshes "
        "--object {wildcards.body} "
        "--meshes {output.meshes:q} "
        "--threads {threads} > {log:q} 2>&1"
