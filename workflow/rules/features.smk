# The arrays that training reads, from one shard. Not part of `all`.


rule features:
    input:
        shard=paths.shard,
    output:
        features=directory(paths.features),
    log:
        paths.log("features", "shard"),
    conda:
        "../../envs/learn.yaml"
    container:
        image("learn")
    threads: 1
    resources:
        mem_mb=memory("collect"),
        runtime=minutes("collect"),
    params:
        options=plan.options("features"),
        version=VERSIONS["features"],
    message:
        "features of shard {wildcards.shard}"
    shell:
        "vibraverse features "
        "--shard {input.shard:q} "
        "--features {output.features:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
