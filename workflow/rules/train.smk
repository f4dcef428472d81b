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
    threads: 2 * max(1, plan.config.learn.gpus)
    resources:
        mem_mb=memory("train", max(1, plan.config.learn.gpus)),
        runtime=minutes("train"),
        gpu=plan.config.learn.gpus,
    params:
        options=lambda wildcards: plan.training(wildcards),
        version=VERSIONS["train"],
    message:
        "training: {wildcards.task}, {wildcards.model}, split {wildcards.split}, seed {wildcards.seed}"
    shell:
        # exec: a scheduler signals the shell, too, which would end at once and leave the training without a job.
        # The number of GPUs is no parameter, for another number makes no model anew.
        "exec vibraverse gpus --claim {resources.gpu} -- "
        "vibraverse train "
        "--features {input.features:q} "
        "--splits {input.splits:q} "
        "--model {output.model:q} "
        "--curves {output.curves:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} "
        "--gpus {resources.gpu} > {log:q} 2>&1"
