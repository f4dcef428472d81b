# The answers of one trained model beside the truth. Not part of `all`.


rule evaluate:
    input:
        model=paths.trained_model,
        training=paths.training_record,
        features=targets.features(plan),
        splits=paths.splits,
    output:
        answers=paths.answers,
        record=paths.evaluation,
    log:
        paths.log("evaluate", "task", "split", "model", "seed"),
    conda:
        "../../envs/learn.yaml"
    container:
        image("learn")
    threads: 1
    resources:
        mem_mb=memory("train"),
        runtime=minutes("collect"),
    params:
        options=lambda wildcards: plan.training(wildcards),
        version=VERSIONS["evaluate"],
    message:
        "evaluation: {wildcards.task}, {wildcards.model}, split {wildcards.split}, seed {wildcards.seed}"
    shell:
        "vibraverse evaluate "
        "--model {input.model:q} "
        "--training {input.training:q} "
        "--features {input.features:q} "
        "--splits {input.splits:q} "
        "--answers {output.answers:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
