# The table of all known bodies, and the verdict on the physics: the target `validation`. Not part of `all`.


rule validation_table:
    input:
        comparisons=targets.validation_comparisons(plan),
    output:
        table=report(paths.validation_table, caption="../report/validation.rst", category="Validation"),
        record=paths.validation_record,
        plot=report(paths.validation_plot, caption="../report/convergence.rst", category="Validation"),
    log:
        paths.log("validation_table"),
    conda:
        "../../envs/report.yaml"
    container:
        image("report")
    threads: 1
    resources:
        mem_mb=memory("light"),
        runtime=minutes("light"),
    params:
        version=VERSIONS["validation_table"],
    message:
        "table and plot of the validation"
    shell:
        "vibraverse validation_table "
        "--comparisons {input.comparisons:q} "
        "--table {output.table:q} "
        "--record {output.record:q} "
        "--plot {output.plot:q} "
        "--threads {threads} > {log:q} 2>&1"


rule validation:
    input:
        record=paths.validation_record,
    output:
        verdict=paths.validation_verdict,
    log:
        paths.log("validation"),
    retries: 0
    conda:
        "../../envs/report.yaml"
    container:
        image("report")
    threads: 1
    resources:
        mem_mb=memory("light"),
        runtime=minutes("light"),
    message:
        "the verdict on the physics"
    shell:
        "vibraverse validation --record {input.record:q} --verdict {output.verdict:q} > {log:q} 2>&1"
