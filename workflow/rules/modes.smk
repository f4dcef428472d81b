# Frequencies, damping and shapes of all materials of a body: milliseconds each.


rule modes:
    input:
        basis=paths.basis,
        tets=paths.tets,
        clean_record=paths.clean_record,
    output:
        modes=paths.modes,
    log:
        paths.log("modes", "object", "solidity"),
    conda:
        "../../envs/fem.yaml"
    container:
        image("fem")
    threads: 1
    resources:
        mem_mb=memory(plan.modes_class()),
        runtime=minutes(plan.modes_class()),
    params:
        options=lambda wildcards: plan.options("modes", object_=wildcards.object),
        version=VERSIONS["modes"],
    message:
        "{wildcards.object}, {wildcards.solidity}: modes of all materials"
    shell:
        "vibraverse modes "
        "--object {wildcards.object} --solidity {wildcards.solidity} "
        "--basis {input.basis:q} "
        "--tets {input.tets:q} "
        "--clean-record {input.clean_record:q} "
        "--modes {output.modes:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
