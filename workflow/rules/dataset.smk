# One HDF5 shard from the products of its objects.
# A run that only joins takes the shards as they are, so it plans no jobs of objects.

if not plan.joins:

    rule dataset:
        input:
            products=lambda wildcards: targets.shard_products(plan, known("shard", wildcards.shard)),
        output:
            shard=paths.shard,
        log:
            paths.log("dataset", "shard"),
        conda:
            "../../envs/dataset.yaml"
        container:
            image("dataset")
        threads: 1
        resources:
            mem_mb=memory("collect"),
            runtime=minutes("collect"),
        params:
            options=lambda wildcards: plan.options("dataset", shard=wildcards.shard),
            version=VERSIONS["dataset"],
        message:
            "dataset shard {wildcards.shard}"
        shell:
            "vibraverse dataset "
            "--shard {output.shard:q} "
            "--options {params.options:q} "
            "--threads {threads} > {log:q} 2>&1"
