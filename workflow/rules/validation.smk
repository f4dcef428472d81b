# Bodies whose frequencies are known, by the path every object takes: meshed, solved, compared, judged. Not part of `all`.


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


rule validation_modes:
    input:
        meshes=paths.validation_meshes,
    output:
        record=paths.validation_comparison,
    log:
        paths.log("validation_modes", "body"),
    conda:
        "../../envs/fem.yaml"
    container:
        image("fem")
    threads: 1
    resources:
        mem_mb=memory("solver"),
        runtime=minutes("solver"),
    params:
        version=VERSIONS["validation_modes"],
        solver=[VERSIONS[stage] for stage in ("basis", "modes")],
    message:
        "{wildcards.body}: frequencies beside those it must have"
    shell:
        "vibraverse validation_modes "
        "--object {wildcards.body} "
        "--meshes {input.meshes:q} "
        "--record {output.record:q} "
        "--threads {threads} > {log:q} 2>&1"


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
