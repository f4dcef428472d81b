# The simple predictors of a task, on one split. Not part of `all`.


rule baselines:
    input:
        features=targets.features(plan),
        splits=paths.splits,
    output:
        record=paths.baselines,
    log:
        paths.log("baselines", "task", "split"),
    conda:
        "../../envs/learn.yaml"
    container:
        image("learn")
    threads: 1
    resources:
        mem_mb=memory("train"),
        runtime=minutes("collect"),
    params:
        options=lambda wildcards: plan.comparison(wildcards),
        version=VERSIONS["baselines"],
    message:
        "baselines: {wildcards.task}, split {wildcards.split}"
    shell:
        "vibraverse baselines "
        "--features {input.features:q} "
        "--splits {input.splits:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
