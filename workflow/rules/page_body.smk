# The data with which a body is struck on the page. A run that only joins takes them as they are.

if not plan.joins:

    rule page_body:
        input:
            basis=paths.basis,
            modes=paths.modes,
        output:
            script=paths.page_body,
            record=paths.page_body_record,
        log:
            paths.log("page_body", "object", "solidity"),
        conda:
            "../../envs/geometry.yaml"
        container:
            image("geometry")
        threads: 1
        resources:
            mem_mb=memory("light"),
            runtime=minutes("light"),
        params:
            version=VERSIONS["page_body"],
        message:
            "{wildcards.object}, {wildcards.solidity}: data of the page"
        shell:
            "vibraverse page_body "
            "--object {wildcards.object} --solidity {wildcards.solidity} "
            "--basis {input.basis:q} "
            "--modes {input.modes:q} "
            "--script {output.script:q} "
            "--record {output.record:q} "
            "--threads {threads} > {log:q} 2>&1"
