# A part of the tested bodies, sought by descent through the physics. Not part of `all`.


rule diffsound:
    input:
        features=targets.features(plan),
        splits=paths.splits,
    output:
        found=paths.descents,
        record=paths.descents_record,
    log:
        paths.log("diffsound", "split", "part"),
    conda:
        "../../envs/learn.yaml"
    container:
        image("learn")
    threads: 1
    resources:
        mem_mb=memory("train"),
        runtime=minutes("train"),
    params:
        options=lambda wildcards: plan.descent(wildcards),
        version=VERSIONS["diffsound"],
    message:
        "DiffSound: split {wildcards.split}, part {wildcards.part}"
    shell:
        "vibraverse diffsound "
        "--features {input.features:q} "
        "--splits {input.splits:q} "
        "--found {output.found:q} "
        "--record {output.record:q} "
        "--options {params.options:q} "
        "--threads {threads} > {log:q} 2>&1"
