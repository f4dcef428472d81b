# Occupancy and signed distance of the solid.


rule grids:
    input:
        surface=paths.surface,
    output:
        grids=paths.grids,
        coarse=paths.coarse,
    log:
        paths.log("grids", "object"),
    conda:
        "../../envs/geometry.yaml"
    container:
        image("geometry")
    threads: 1
    resources:
        mem_mb=memory("geometry"),
        runtime=minutes("geometry"),
    params:
        options=plan.options("grids"),
        version=VERSIONS["grids"],
    message:
        "{wildcards.object}: voxels and signed distance"
    shell:
        "vibraverse grids "
        "--object {wildcards.object} "
        "--surface {input.surface:q} "
        "--grids {output.grids:q} "
        "--coarse {output.coarse:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
