# One training: a task, a split, a model, a seed. Not part of `all`.


rule train:
    input:
        features=targets.features(plan),
        splits=paths.splits,
    output:
        model=paths.trained_model,
        curves=paths.training_curves,
        record=paths.training_record,
    log:
        paths.log("train", "task", "split", "model", "seed"),
    conda:
        "../../envs/learn.yaml"
    container:
        image("learn")
    threads: 2
    resources:
        mem_mb=memory("train"),
        runtime=minutes("train"),
        gpu=plan.config.learn.gpus,
    params:
        options=lambda wildcards: plan.training(wildcards),
        version=VERSIONS["train"],
        claim=targets.gpu_claim(plan),
    message:
        "training: {wildcards.task}, {wildcards.model}, split {wildcards.split}, seed {wildcards.seed}"
    shell:
        "{params.claim}vibraverse train "
        "--features {input.features:q} "
        "--splits {input.splits:q} "
        "--model {output.model:q} "
        "--curves {output.curves:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
