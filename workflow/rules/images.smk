# Views of the outside; solid and hollow look the same.


rule images:
    input:
        surface=paths.surface,
    output:
        views=directory(paths.views),
    log:
        paths.log("images", "object"),
    conda:
        "../../envs/render.yaml"
    container:
        image("render")
    threads: 1
    resources:
        mem_mb=memory("render"),
        runtime=minutes("render"),
    params:
        options=plan.options("images"),
        version=VERSIONS["images"],
    message:
        "{wildcards.object}: views"
    shell:
        "vibraverse images "
        "--object {wildcards.object} "
        "--surface {input.surface:q} "
        "--views {output.views:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
