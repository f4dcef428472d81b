# A mesh as it came, with its origin.


rule sources:
    input:
        file=lambda wildcards: targets.source_file(plan, known("object", wildcards.object)),
    output:
        mesh=paths.source_mesh,
        record=paths.source_record,
    log:
        paths.log("sources", "object"),
    conda:
        "../../envs/geometry.yaml"
    container:
        image("geometry")
    threads: 1
    resources:
        mem_mb=memory("light"),
        runtime=minutes("light"),
    params:
        file=lambda wildcards: targets.source_argument(plan, wildcards.object),
        options=lambda wildcards: plan.options("sources", object_=wildcards.object),
        version=VERSIONS["sources"],
    message:
        "{wildcards.object}: get the mesh"
    shell:
        "vibraverse sources --object {wildcards.object} {params.file} "
        "--mesh {output.mesh:q} --record {output.record:q} "
        "--options {params.options:q} --threads {threads} > {log:q} 2>&1"
