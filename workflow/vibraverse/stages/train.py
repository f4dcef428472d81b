"""Stage ``train``: the features of all shards in, one trained model out.

Checkpoints lie in the stage's work folder, so a training that was ended goes on where it was.
"""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Train, and write the weights, the curves and how it went."""
    from dataclasses import asdict

    import torch

    from vibraverse.learn.curves import write_csv
    from vibraverse.learn.tasks import task_at
    from vibraverse.learn.train import train

    torch.set_num_threads(job.threads)
    options = job.options
    task = task_at(job.inputs["features"], job.inputs["splits"], options)
    trained = train(
        task,
        options.training,
        job.work / "checkpoints",
        seed=options.seed,
        facts={"made of": job.provenance()},
        device="cuda" if options.gpus else "cpu",
    )
    weights = {"best": trained.best, "last": trained.model}
    torch.save(weights, job.outputs["model"])
    write_csv(job.outputs["curves"], trained.curves)
    sizes = {name: len(bodies) for name, bodies in task.sides.items()}
    record = {"metrics": trained.metrics, "bodies": sizes, "threads": job.threads}
    job.write_record({**record, "features": asdict(task.samples.layout())})
