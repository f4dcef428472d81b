"""The benchmark tasks: what a network gets, what it is asked, and how its answers are judged."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vibraverse.contract.errors import UsageError
from vibraverse.dataset.schema import SPLIT_COLUMNS
from vibraverse.dataset.schema.tables import from_tsv
from vibraverse.learn.samples import Samples
from vibraverse.learn.sides import TooFew, sides

#: Task -> its class, imported when it is asked for.
TASKS = {
    "frequencies": "frequencies:Frequencies",
    "solidity": "solidity:Solidity",
    "reconstruction": "reconstruction:Reconstruction",
    "cavity": "cavity:Cavity",
    "retrieval": "retrieval:Retrieval",
}
#: Task and model -> class of a model that wants other samples than the rest of its task.
OWN = {("frequencies", "subspace"): "subspace:SubspaceTask"}


def task_at(features: Sequence[Path], splits: Path, options):
    """Return a task over features, named by their records; ``options`` are :class:`vibraverse.config.learn.RunOptions`.

    Raises :class:`UsageError` for a dataset that the task cannot use.
    """
    return task_of(*samples_and_sides(features, splits, options), options)


def task_of(samples: Samples, chosen: dict[str, np.ndarray], options):
    """Return the task of the options over samples, with the bodies that are chosen for each side."""
    module, _, name = OWN.get((options.task, options.model), TASKS[options.task]).partition(":")
    return getattr(importlib.import_module(f"vibraverse.learn.tasks.{module}"), name)(
        samples, chosen, options
    )


def samples_and_sides(
    features: Sequence[Path], splits: Path, options
) -> tuple[Samples, dict[str, np.ndarray]]:
    """Return the samples of features, named by their records, and the numbers of the bodies on every side.

    Of ``options`` it reads what concerns the split. Raises as :func:`task_at` does, and needs no torch.
    """
    try:
        samples = Samples([record.parent for record in features])
        rows = {row["object"]: row for row in from_tsv(splits.read_text(encoding="utf-8"), SPLIT_COLUMNS)}
        missing = sorted(set(samples.object) - set(rows))
        if missing:
            raise UsageError(
                f"{splits} lacks the object {missing[0]}: features and splits are of different datasets; run the same "
                "command again, which makes what is out of date"
            )
        samples.know_copies({name: row["copy_of"] for name, row in rows.items()})
        return samples, sides(
            samples, options.split, rows, options.folds, options.hold_out, options.leave_out
        )
    except TooFew as error:
        raise UsageError(f"learn: {error}") from None
    except ValueError as error:
        raise UsageError(f"{splits}: {error}") from None
