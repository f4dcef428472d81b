"""One training of a model on features, as plain data that a process started anew can read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from vibraverse.config.learn import RunOptions
from vibraverse.learn.tasks import task_at
from vibraverse.learn.train import Trained, train


@dataclass(frozen=True)
class Assignment:
    """What is trained, and where.

    ``features`` are the records of the features, ``splits`` is ``splits.tsv``, ``options`` are those of
    :class:`RunOptions`, ``work`` is the folder of the checkpoints, ``facts`` see :func:`~vibraverse.learn.train.train`.
    ``device`` is ``cpu`` or ``cuda``, ``threads`` are those of each process.
    """

    features: list[str]
    splits: str
    options: dict
    work: str
    facts: dict
    device: str
    threads: int

    def train(self, say: Callable[[str], None] = print) -> tuple[Trained, dict]:
        """Train the model in this process, alone or among others; return it, and what it was trained on.

        That is the number of ``bodies`` on each side, and what the ``features`` are like.

        Raises as :func:`~vibraverse.learn.train.train` does, and :class:`UsageError` for features that the task cannot
        use.
        """
        torch.set_num_threads(self.threads)
        options = RunOptions(**self.options)
        task = task_at([Path(one) for one in self.features], Path(self.splits), options)
        trained = train(
            task,
            options.training,
            self.work,
            seed=options.seed,
            facts=self.facts,
            device=self.device,
            say=say,
        )
        sizes = {name: len(bodies) for name, bodies in task.sides.items()}
        return trained, {"bodies": sizes, "features": asdict(task.samples.layout())}
