"""Stage ``diffsound``: the features of all shards in, what a descent through the physics finds for some bodies out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Seek one body after the other; those that are done survive a kill."""
    import time

    import numpy as np
    import torch

    from vibraverse.learn.descents import all_sought, chosen
    from vibraverse.learn.diffsound import Settings
    from vibraverse.learn.tasks import task_at

    torch.set_num_threads(job.threads)
    options, asked = job.options, job.options.diffsound
    task = task_at(job.inputs["features"], job.inputs["splits"], options)
    bodies = chosen(task, asked.bodies, options.part, asked.parts)
    settings = Settings(**asked.model_dump(exclude={"bodies", "parts"}))
    work = job.work / "bodies"
    work.mkdir(exist_ok=True)
    began = time.perf_counter()
    found = all_sought(task, bodies, settings, work)
    np.savez(job.outputs["found"], **found)
    job.write_record({"bodies": found["body"].tolist(), "seconds": time.perf_counter() - began})
