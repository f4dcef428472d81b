"""The table of learning: a row per model, split, side, source and measure, over all seeds and folds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np

from vibraverse.learn.facts import identity

#: Columns of ``results.tsv``: type and meaning.
COLUMNS: dict[str, tuple[type, str]] = {
    "task": (str, "the task"),
    "model": (str, "the model or baseline"),
    "split": (str, "`object`, or `family` over all its folds"),
    "side": (str, "`test`, or `held_out` for origins that are never trained on"),
    "source": (str, "which bodies: all, of an origin, solid, hollow, of a thickness"),
    "measure": (str, "what is measured"),
    "value": (float, "mean over trainings"),
    "low": (float, "smallest over trainings, or the end of the interval of a single one"),
    "high": (float, "largest over trainings, or the end of the interval of a single one"),
    "trainings": (int, "number of trainings: seeds times folds"),
    "count": (int, "tested bodies, over all folds"),
    "kind": (str, "`published`, `model`, `control` (gets too little to answer), or `baseline`"),
    "preset": (str, "size of the training; `tiny` is a toy and proves nothing"),
    "minutes": (float, "mean wall time of a training"),
    "hardware": (str, "processor or GPU of the trainings; where they differ, here and below, all values"),
    "threads": (str, "threads of a training"),
    "config_hash": (str, "beginning of the SHA-256 of the resolved options"),
    "data_sha256": (str, "beginning of the checksum of the dataset"),
    "version": (str, "version of vibraverse"),
}


def evaluation(options, model: str, rows: list[dict], training: dict, provenance: dict) -> dict:
    """Return the evaluation of one model or baseline: what was asked, its rows, how it was made.

    ``options`` are :class:`vibraverse.config.learn.RunOptions`, ``provenance`` is that of a job that read the features.
    """
    return {
        "task": options.task,
        "model": model,
        "split": options.split,
        "seed": options.seed,
        "rows": rows,
        "training": training,
        "config_hash": identity(
            options.model_dump(mode="json", exclude={"seed", "split", "model"}) | {"model": model}
        ),
        "data_sha256": identity(provenance["input_sha256"]["features"]),
        "version": provenance["vibraverse"],
    }


def table(evaluations: list[dict]) -> list[dict]:
    """Return the rows of all evaluations, the trainings of one model and split joined."""
    groups: dict[tuple, list[tuple[dict, dict]]] = defaultdict(list)
    for one in evaluations:
        split = one["split"].partition("-")[0]
        for row in one["rows"]:
            groups[one["task"], one["model"], split, row["side"], row["source"], row["measure"]].append(
                (one, row)
            )
    return [_row(key, members) for key, members in sorted(groups.items())]


def _row(key: tuple, members: list[tuple[dict, dict]]) -> dict:
    values = [row["value"] for _, row in members]
    low, high = (min(values), max(values)) if len(members) > 1 else (
        members[0][1].get("low", values[0]), members[0][1].get("high", values[0])
    )  # fmt: skip
    counts = {(one["split"]): row["count"] for one, row in members}
    names = ("task", "model", "split", "side", "source", "measure")
    return dict(zip(names, key, strict=True)) | {
        "value": float(np.mean(values)),
        "low": low,
        "high": high,
        "trainings": len(members),
        "count": sum(counts.values()),
        "minutes": round(float(np.mean([one["training"]["minutes"] for one, _ in members])), 2),
        **{
            name: joined([one["training"][name] for one, _ in members])
            for name in ("kind", "preset", "hardware", "threads")
        },
        **{
            name: joined([one[name] for one, _ in members])
            for name in ("config_hash", "data_sha256", "version")
        },
    }


def joined(values: Iterable) -> str:
    """Return the values of the trainings of a row as one text: the only one, or all that differ with commas."""
    return ", ".join(sorted({str(value) for value in values}))
