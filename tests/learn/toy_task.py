"""A small regression for tests of the trainer, and ways to run it in processes of its own."""

from __future__ import annotations

import os
import socket
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch

from vibraverse.config.training import Training
from vibraverse.learn.interruption import Interrupted
from vibraverse.learn.task import Keyed, Task
from vibraverse.learn.train import Trained, train

#: Exit status of a process of :func:`in_processes` that was interrupted.
INTERRUPTED = 75
SIZES = {"train": 40, "validation": 13, "test": 7}


class Toy(Task):
    """Learn a smooth function of four numbers. Samples carry noise that is new in every epoch."""

    best = "squared_error"

    def __init__(self, sizes=None, *, noise=0.1, dropout=0.0, norm=False, seed=0):
        self.sizes, self.noise, self.seed = {**SIZES, **(sizes or {})}, noise, seed
        self.dropout, self.norm = dropout, norm
        self.at_losses: Callable[[], None] = lambda: None

    def model(self):
        middle = torch.nn.BatchNorm1d(16) if self.norm else torch.nn.Identity()
        return torch.nn.Sequential(
            torch.nn.Linear(4, 16),
            middle,
            torch.nn.Tanh(),
            torch.nn.Dropout(self.dropout),
            torch.nn.Linear(16, 1),
        )

    def dataset(self, split):
        draws = np.random.default_rng(len(split))
        inputs = draws.uniform(-1, 1, (self.sizes[split], 4)).astype(np.float32)
        items = [{"x": x, "y": np.float32(np.sin(2 * x[0]) + x[1] * x[2])} for x in inputs]
        return Keyed(items, self.seed, self._with_noise if split == "train" else None)

    def _with_noise(self, item, generator):
        return {**item, "x": item["x"] + self.noise * generator.standard_normal(4).astype(np.float32)}

    def ids(self, split):
        return [f"{split}-{index:03d}" for index in range(self.sizes[split])]

    def losses(self, model, batch):
        self.at_losses()
        return (model(batch["x"])[:, 0] - batch["y"]) ** 2

    def predict(self, model, batch):
        return {"squared_error": self.losses(model, batch), "x": batch["x"]}

    def score(self, predictions):
        assert predictions["x"].shape == (len(predictions["squared_error"]), 4)
        return {
            "squared_error": float(predictions["squared_error"].mean(dtype=np.float64)),
            "samples": len(predictions["x"]),
        }


def options(**changes) -> Training:
    given = {
        "steps": 24,
        "batch_size": 8,
        "learning_rate": 1e-2,
        "validate_every": 7,
        "checkpoint_minutes": 1e-9,
    }
    return Training(**{**given, **changes})


def run(work: Path, task: Task | None = None, **changes) -> Trained:
    """Train the toy on the CPU without words; ``changes`` are options, ``seed``, ``facts``, ``say`` or ``device``."""
    torch.set_num_threads(1)
    given = {"seed": 3, "facts": {"data": "abc"}, "say": lambda line: None, "device": "cpu"}
    given |= {name: changes.pop(name) for name in list(changes) if name in given}
    return train(task or Toy(), options(**changes), work, **given)


def same(one: Trained, other: Trained) -> None:
    """Assert that two trainings gave the same weights, metrics and losses, to the last digit."""
    for weights in ("model", "best"):
        first, second = getattr(one, weights), getattr(other, weights)
        assert first.keys() == second.keys()
        assert all(torch.equal(first[name], second[name]) for name in first), weights
    for name in ("validation", "best", "steps", "loss", "ended"):
        assert one.metrics[name] == other.metrics[name]
    columns = ("step", "learning_rate", "loss", "gradient_norm", "validation")
    assert [[row[name] for name in columns] for row in one.curves] == [
        [row[name] for name in columns] for row in other.curves
    ]


def in_processes(work: Callable[[int], None], count: int = 1, group: bool = False) -> list[int]:
    """Run ``work(rank)`` in forks of this process; return their exit statuses, negative for a signal.

    With ``group`` they find themselves as under torchrun.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    children = []
    for rank in range(count):
        child = os.fork()
        if not child:
            _in_child(work, rank, count, port if group else None)
        children.append(child)
    return [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]


def _in_child(work, rank: int, count: int, port: int | None) -> None:
    status = 1
    try:
        if port is not None:
            os.environ |= {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": str(count)}
            os.environ |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
        work(rank)
        status = 0
    except Interrupted:
        status = INTERRUPTED
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


@contextmanager
def at_event(number: int, act: Callable[[], None], task: Toy) -> Iterator[list[int]]:
    """Call ``act`` at the ``number``-th event: a network's call, a flush to disk, a rename. Yield the count so far."""
    seen = [0]
    fsync, replace = os.fsync, os.replace

    def event():
        seen[0] += 1
        if seen[0] == number:
            act()

    def counted(function):
        def call(*arguments):
            event()
            return function(*arguments)

        return call

    os.fsync, os.replace, task.at_losses = counted(fsync), counted(replace), event
    try:
        yield seen
    finally:
        os.fsync, os.replace = fsync, replace
