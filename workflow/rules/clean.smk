# A closed, oriented, manifold surface in [-1, 1]³.


rule clean:
    input:
        mesh=paths.source_mesh,
        source_record=paths.source_record,
    output:
        surface=paths.surface,
        record=paths.clean_record,
    log:
        paths.log("clean", "object"),
    conda:
        "../../envs/geometry.yaml"
    container:
        image("geometry")
    threads: 1
    resources:
        mem_mb=memory("geometry"),
        runtime=minutes("geometry"),
    params:
        options=plan.options("clean"),
        version=VERSIONS["clean"],
    message:
        "{wildcards.object}: clean the surface"
    shell:
        "vibraverse clean "
        "--object {wildcards.object} "
        "--mesh {input.mesh:q} "
        "--source-record {input.source_record:q} "
        "--surface {output.surface:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
