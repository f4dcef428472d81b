"""Speed of the loader that feeds training, by the number of its workers, and how long training waits for it.

    python benchmarks/loader.py [--features FOLDER] [--models TASK/MODEL …] [--workers 0 2] [--preset cpu]
        [--seconds 10] [--device cpu]

FOLDER holds features as a run writes them (``results/learn/features``), with a copy of ``dataset/splits.tsv``. Without
it smooth bodies are invented. The loader's own speed is measured with nothing else to do; then a training runs as long.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from vibraverse.machine.threads import set_threads

set_threads(1)

#: The published model of each task, and the model whose steps are the cheapest.
DEFAULT = [
    "frequencies/published", "frequencies/ritz", "solidity/published", "reconstruction/published", "cavity/sound",
    "retrieval/published",
]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--features", type=Path)
    parser.add_argument(
        "--models", nargs="+", default=DEFAULT, metavar="TASK/MODEL", help=f"default: {' '.join(DEFAULT)}"
    )
    parser.add_argument("--preset", default="cpu", choices=["tiny", "cpu", "small", "paper"])
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 2])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--objects", type=int, default=120, help="objects that are invented")
    parser.add_argument("--device", default="cpu")
    arguments = parser.parse_args()
    import synthetic

    from vibraverse.config.learn import Features

    print("| task, model | workers | loader alone, samples/s | training, samples/s | waiting for data |")
    print("|" + 5 * " --- |")
    with tempfile.TemporaryDirectory() as folder:
        features = arguments.features or Path(folder)
        if arguments.features is None:
            points = 512 if arguments.preset == "tiny" else 4096
            synthetic.write(features, arguments.objects, Features(points=points))
        for name, model in (one.split("/") for one in arguments.models):
            for workers in arguments.workers:
                task = synthetic.task(features, name, model, arguments.preset, workers=workers)
                alone = rate(task, arguments.seconds, arguments.device)
                minutes = arguments.seconds / 60
                task = synthetic.task(
                    features, name, model, arguments.preset, workers=workers, minutes=minutes
                )
                speed, waiting = trained(task, Path(folder) / f"{name}-{model}-{workers}", arguments.device)
                print(
                    f"| {name}, {model} | {workers} | {alone:,.0f} | {speed:,.0f} | {100 * waiting:.0f} % |",
                    flush=True,
                )


def rate(task, seconds: float, device: str) -> float:
    """Return samples per second of the loader, without the start of its workers."""
    import torch

    from vibraverse.learn import evaluation, order
    from vibraverse.learn.ranks import Ranks

    data, options = evaluation.samples(task, "train"), task.options.training
    keys = order.StepKeys(0, 0, 10**6, len(data), options.batch_size)
    batches = evaluation.batches(task, data, keys, options, Ranks(torch.device(device)))
    for _ in range(2 * max(options.workers, 1) + 1):  # batches that workers have ready
        next(batches)
    began, count = time.perf_counter(), 0
    while time.perf_counter() - began < seconds:
        next(batches)
        count += options.batch_size
    took = time.perf_counter() - began
    batches.close()
    return count / took


def trained(task, work: Path, device: str) -> tuple[float, float]:
    """Return samples per second of a training, and the share of time that it waits for data."""
    from vibraverse.learn.train import train

    options = task.options.training
    done = train(task, options, work, seed=0, facts={}, device=device, say=lambda line: None)
    return done.metrics["samples_per_s"], done.metrics["waiting_share"]


if __name__ == "__main__":
    main()
