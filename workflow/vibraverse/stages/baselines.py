"""Stage ``baselines``: the features of all shards in, the measures of simple predictors out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Fit each baseline of a task on one split, and judge it like a model."""
    from vibraverse.learn.baselines.rows import baselines
    from vibraverse.learn.descents import read
    from vibraverse.learn.hardware import processor
    from vibraverse.learn.results import evaluation
    from vibraverse.learn.tasks import task_at

    options = job.options
    task = task_at(job.inputs["features"], job.inputs["splits"], options)
    descents = [read(path) for path in job.inputs.get("descents") or ()]
    made_of = job.provenance()
    about = {"kind": "baseline", "preset": "", "hardware": processor(), "threads": job.threads}
    found = [
        evaluation(options, name, judgement, {**about, "minutes": seconds / 60}, made_of)
        for name, seconds, judgement in baselines(task, descents)
    ]
    job.write_record({"evaluations": found})
