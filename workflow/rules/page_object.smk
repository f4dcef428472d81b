# What the page shows of an object. A run that only joins takes them as they are.

if not plan.joins:

    rule page_object:
        input:
            **targets.shown(plan),
            source_record=paths.source_record,
            clean_record=paths.clean_record,
            views=paths.views,
            tets_record=targets.of_bodies(plan, paths.tets_record),
            modes=targets.of_bodies(plan, paths.modes),
            sounds=targets.of_bodies(plan, paths.sounds),
            page_body_record=targets.of_bodies(plan, paths.page_body_record),
        output:
            script=paths.page_object,
            turn=paths.page_turn,
            thumbnail=paths.page_thumbnail,
            record=paths.page_object_record,
        log:
            paths.log("page_object", "object"),
        conda:
            "../../envs/report.yaml"
        container:
            image("report")
        threads: 1
        resources:
            mem_mb=memory("light"),
            runtime=minutes("light"),
        params:
            version=VERSIONS["page_object"],
        message:
            "{wildcards.object}: data of the page"
        shell:
            "vibraverse page_object "
            "--object {wildcards.object} "
            "--source-record {input.source_record:q} "
            "--clean-record {input.clean_record:q} "
            "--views {input.views:q} "
            "--tets-record {input.tets_record:q} "
            "--modes {input.modes:q} "
            "--sounds {input.sounds:q} "
            "--page-body-record {input.page_body_record:q} "
            f"{targets.shown_arguments(plan)} "
            "--script {output.script:q} "
            "--turn {output.turn:q} "
            "--thumbnail {output.thumbnail:q} "
            "--record {output.record:q} "
            "--threads {threads} > {log:q} 2>&1"
