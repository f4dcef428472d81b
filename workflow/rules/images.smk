# Views of the outside; solid and hollow look the same.


rule images:
    input:
        surface=paths.surface,
    output:
        views=targets.views(plan),
        record=paths.images_record,
    params:
        options=plan.options("images"),
        version=VERSIONS["images"],
    log:
        paths.log("images", "object"),
    benchmark:
        paths.benchmark("images", "object")
    threads: 1
    resources:
        mem_mb=memory("render"),
        runtime=minutes("render"),
    conda:
        "../../envs/render.yaml"
    message:
        "{wildcards.object}: views"
    shell:
        "vibraverse images "
        "--object {wildcards.object} "
        "--surface {input.surface:q} "
        "--views {output.views:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log} 2>&1"
