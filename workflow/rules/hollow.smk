# The surface of the hollow body.


rule hollow:
    input:
        surface=paths.surface,
        grids=paths.grids,
    output:
        hollow_surface=paths.hollow_surface,
        record=paths.hollow_record,
    log:
        paths.log("hollow", "object"),
    conda:
        "../../envs/geometry.yaml"
    container:
        image("geometry")
    threads: 1
    resources:
        mem_mb=memory("geometry"),
        runtime=minutes("geometry"),
    params:
        options=plan.options("hollow"),
        version=VERSIONS["hollow"],
    message:
        "{wildcards.object}: hollow the body"
    shell:
        "vibraverse hollow "
        "--object {wildcards.object} "
        "--surface {input.surface:q} "
        "--grids {input.grids:q} "
        "--hollow-surface {output.hollow_surface:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
