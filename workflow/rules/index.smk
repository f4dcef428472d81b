# Tables, card and checksums of the dataset, and the split of every object.


rule index:
    input:
        shards=targets.shards(plan),
        kept=targets.kept_splits(plan),
    output:
        index=paths.index,
        columns=paths.index_columns,
        parquet=paths.index_parquet,
        splits=paths.splits,
        refusals=paths.refusals,
        record=paths.dataset_record,
        card=paths.card,
        overview=paths.overview,
        croissant=paths.croissant,
        config=paths.dataset_config,
        sums=paths.dataset_sums,
    log:
        paths.log("index"),
    conda:
        "../../envs/dataset.yaml"
    container:
        image("dataset")
    threads: 1
    resources:
        mem_mb=memory("collect"),
        runtime=minutes("collect"),
    params:
        options=plan.options("index"),
        kept=targets.kept_splits_argument(plan),
        # Written when the run starts; as an input of the rule it would have to exist for `-n`, too.
        resolved=paths.config,
        configuration=text_sha256(plan.configuration()),
        version=VERSIONS["index"],
    message:
        "index of the dataset"
    shell:
        "vibraverse index "
        "--shards {input.shards:q} "
        "{params.kept} "
        "--index {output.index:q} "
        "--columns {output.columns:q} "
        "--parquet {output.parquet:q} "
        "--splits {output.splits:q} "
        "--refusals {output.refusals:q} "
        "--record {output.record:q} "
        "--card {output.card:q} "
        "--overview {output.overview:q} "
        "--croissant {output.croissant:q} "
        "--resolved {params.resolved:q} "
        "--config {output.config:q} "
        "--sums {output.sums:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
