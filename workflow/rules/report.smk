# The page people open, and the verdict on the run.


rule report:
    input:
        index=paths.index_columns,
        record=paths.dataset_record,
        objects=targets.page_objects(plan),
        validation=targets.validation_done(plan),
    output:
        page=paths.report,
        times=paths.page_times,
    log:
        paths.log("report"),
    conda:
        "../../envs/report.yaml"
    container:
        image("report")
    threads: 1
    resources:
        mem_mb=memory("collect"),
        runtime=minutes("collect"),
    params:
        options=plan.options("report"),
        validation=targets.validation_argument(plan),
        learning=targets.link_argument("learning", paths.learn_page),
        version=VERSIONS["report"],
    message:
        "the report"
    shell:
        "vibraverse report "
        "--index {input.index:q} "
        "--record {input.record:q} "
        "{params.validation} "
        "{params.learning} "
        "--page {output.page:q} "
        "--times {output.times:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"


rule verdict:
    input:
        record=paths.dataset_record,
        page=paths.report,
    output:
        verdict=report(paths.verdict, caption="../report/verdict.rst", category="Run"),
    log:
        paths.log("verdict"),
    retries: 0
    conda:
        "../../envs/dataset.yaml"
    container:
        image("dataset")
    threads: 1
    resources:
        mem_mb=memory("light"),
        runtime=minutes("light"),
    params:
        share=plan.config.dataset.max_refused_share,
    message:
        "the verdict on the run"
    shell:
        "vibraverse refusals --record {input.record:q} --check {params.share} --verdict {output.verdict:q} > {log:q} 2>&1"
