"""Stage ``evaluate``: a trained model and the features in, its answers and their measures out."""

from __future__ import annotations

from vibraverse.contract import products
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Ask the model about every tested body, and judge the answers."""
    import numpy as np
    import torch

    from vibraverse.learn.evaluation import answers
    from vibraverse.learn.judging import judged
    from vibraverse.learn.results import evaluation
    from vibraverse.learn.tasks import task_at

    torch.set_num_threads(job.threads)
    options = job.options
    task = task_at(job.inputs["features"], job.inputs["splits"], options)
    model = task.model()
    model.load_state_dict(torch.load(job.inputs["model"], weights_only=True)["best"])
    found = judged(task, lambda side: answers(task, model, side, options.training))
    with open(job.outputs["answers"], "wb") as file:  # savez would add an ending to the name
        np.savez(file, **found.answers)
    made = products.read_json(job.inputs["training"])
    metrics = made["metrics"]
    training = {
        "kind": task.kind,
        "preset": options.preset,
        "minutes": metrics["seconds"] / 60,
        "threads": made["threads"],
        "hardware": metrics["hardware"]["gpu"] or metrics["hardware"]["cpu"],
        **{name: metrics[name] for name in ("steps", "parameters")},
    }
    job.write_record(evaluation(options, options.model, found, training, job.provenance()))
