# The page of learning: the target `learn`. Not part of `all`.


rule learn_page:
    input:
        results=paths.results_record,
        evaluations=targets.of_trainings(plan, paths.evaluation),
        curves=targets.of_trainings(plan, paths.training_curves),
        answers=targets.of_trainings(plan, paths.answers),
        features=targets.features(plan),
        splits=paths.splits,
        dataset=paths.dataset_record,
    output:
        page=paths.learn_page,
    log:
        paths.log("learn_page"),
    conda:
        "../../envs/report.yaml"
    container:
        image("report")
    threads: 1
    resources:
        mem_mb=memory("collect"),
        runtime=minutes("collect"),
    params:
        report=targets.link_argument("report", paths.report),
        version=VERSIONS["learn_page"],
    message:
        "the page of learning"
    shell:
        "vibraverse learn_page "
        "--results {input.results:q} "
        "--evaluations {input.evaluations:q} "
        "--curves {input.curves:q} "
        "--answers {input.answers:q} "
        "--features {input.features:q} "
        "--splits {input.splits:q} "
        "--dataset {input.dataset:q} "
        "{params.report} "
        "--page {output.page:q} "
        "--threads {threads} > {log:q} 2>&1"


rule learn:
    input:
        page=paths.learn_page,
