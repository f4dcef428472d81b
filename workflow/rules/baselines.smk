# The simple predictors of a task, on one split. Not part of `all`.


rule baselines:
    input:
        features=targets.features(plan),
        splits=paths.splits,
        descents=lambda wildcards: targets.descents(plan, wildcards.task, wildcards.split),
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
        descents=lambda wildcards, input: targets.files_argument("descents", input.descents),
        version=VERSIONS["baselines"],
    message:
        "baselines: {wildcards.task}, split {wildcards.split}"
    shell:
        "vibraverse baselines "
        "--features {input.features:q} "
        "--splits {input.splits:q} "
        "{params.descents} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
