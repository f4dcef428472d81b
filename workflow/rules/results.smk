# The table of all models: the target `learn`. Not part of `all`.


rule results:
    input:
        evaluations=targets.of_trainings(plan, paths.evaluation),
        baselines=targets.baselines(plan),
    output:
        table=paths.results_table,
        record=paths.results_record,
    log:
        paths.log("results"),
    conda:
        "../../envs/learn.yaml"
    container:
        image("learn")
    threads: 1
    resources:
        mem_mb=memory("light"),
        runtime=minutes("light"),
    params:
        version=VERSIONS["results"],
    message:
        "the table of learning"
    shell:
        "vibraverse results "
        "--evaluations {input.evaluations:q} "
        "--baselines {input.baselines:q} "
        "--table {output.table:q} "
        "--record {output.record:q} "
        "--threads {threads} > {log:q} 2>&1"
