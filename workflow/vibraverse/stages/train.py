"""Stage ``train``: the features of all shards in, one trained model out.

Checkpoints lie in the stage's work folder, so a training that was ended goes on where it was.
"""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Train, and write the weights, the curves and how it went."""
    import torch

    from vibraverse.learn.assignment import Assignment
    from vibraverse.learn.curves import write_csv
    from vibraverse.learn.launch import train_together

    options = job.options
    processes = job.gpus or options.processes
    assignment = Assignment(
        features=[str(one) for one in job.inputs["features"]],
        splits=str(job.inputs["splits"]),
        options=options.model_dump(mode="json"),
        work=str(job.work / "checkpoints"),
        facts={"made of": job.provenance()},
        device="cuda" if job.gpus else "cpu",
        threads=max(1, job.threads // processes),
    )
    if processes == 1:
        trained, about = assignment.train()
    else:
        trained, about = train_together(assignment, processes, job.work / "processes")
    torch.save({"best": trained.best, "last": trained.model}, job.outputs["model"])
    write_csv(job.outputs["curves"], trained.curves)
    job.write_record({"metrics": trained.metrics, "threads": job.threads, **about})
