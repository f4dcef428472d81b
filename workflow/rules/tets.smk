# Tetrahedra of the solid or the hollow body, by the same code for both.


rule tets:
    input:
        surface=paths.boundary,
    output:
        tets=paths.tets,
        record=paths.tets_record,
    log:
        paths.log("tets", "object", "solidity"),
    conda:
        "../../envs/geometry.yaml"
    container:
        image("geometry")
    threads: 1
    resources:
        mem_mb=memory("geometry"),
        runtime=minutes("geometry"),
    params:
        options=plan.options("tets"),
        version=VERSIONS["tets"],
    message:
        "{wildcards.object}, {wildcards.solidity}: tetrahedra"
    shell:
        "vibraverse tets "
        "--object {wildcards.object} --solidity {wildcards.solidity} "
        "--surface {input.surface:q} "
        "--tets {output.tets:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
