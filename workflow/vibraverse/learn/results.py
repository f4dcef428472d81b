"""The table of learning: a row per model, split, side, source and measure, over all seeds and folds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

import numpy as np

from vibraverse.learn.facts import identity
from vibraverse.learn.judging import Judgement
from vibraverse.learn.metrics import mcnemar

#: The model that others are compared with, body by body.
REFERENCE = "published"

#: Columns of ``results.tsv``: type and meaning.
COLUMNS: dict[str, tuple[type, str]] = {
    "task": (str, "the task"),
    "model": (str, "the model or baseline"),
    "split": (str, "`object`, or `family` over all its folds"),
    "side": (str, "`test`, or `held_out` for origins that are never trained on"),
    "source": (str, "which bodies: all, of an origin, solid, hollow, of a thickness; which pools"),
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


def evaluation(options, model: str, found: Judgement, training: dict, provenance: dict) -> dict:
    """Return the evaluation of one model or baseline: what was asked, how its answers were judged, how it was made.

    ``options`` are :class:`vibraverse.config.learn.RunOptions`, ``provenance`` is that of a job that read the features.
    """
    return {
        "task": options.task,
        "model": model,
        "split": options.split,
        "seed": options.seed,
        "rows": found.rows,
        "right": found.right,
        "training": training,
        "config_hash": config_hash(options, model),
        "data_sha256": identity(provenance["input_sha256"]["features"]),
        "version": provenance["vibraverse"],
    }


def config_hash(options, model: str) -> str:
    """Return the hash of what the trainings of a model have in common, whatever their seed and split."""
    common = options.model_dump(mode="json", exclude={"seed", "split", "model"})
    return identity(common | {"model": model})


def table(evaluations: list[dict]) -> list[dict]:
    """Return the rows of all evaluations, the trainings of one model and split joined."""
    groups: dict[tuple, list[tuple[dict, dict]]] = defaultdict(list)
    for one in evaluations:
        split = one["split"].partition("-")[0]
        for row in one["rows"]:
            groups[one["task"], one["model"], split, row["side"], row["source"], row["measure"]].append(
                (one, row)
            )
    for one, row in _compared(evaluations):
        split = one["split"].partition("-")[0]
        groups[one["task"], one["model"], split, row["side"], row["source"], row["measure"]].append(
            (one, row)
        )
    return [_row(key, members) for key, members in sorted(groups.items())]


def _compared(evaluations: list[dict]) -> Iterator[tuple[dict, dict]]:
    """Yield rows that compare models with the published one on the same bodies, those of all folds together.

    The value is McNemar's p. A seed is compared with the same seed of the published model.
    """
    right: dict[tuple, dict[str, bool]] = defaultdict(dict)
    about: dict[tuple, dict] = {}
    for one in evaluations:
        for side, bodies in one["right"].items():
            key = one["task"], one["split"].partition("-")[0], side, one["model"], one["seed"]
            right[key] |= bodies
            about.setdefault(key, one)
    for (task, split, side, model, seed), bodies in right.items():
        reference = right.get((task, split, side, REFERENCE, seed), {})
        if model != REFERENCE and reference.keys() == bodies.keys():
            pairs = np.array([(bodies[name], reference[name]) for name in sorted(bodies)], dtype=bool)
            value = mcnemar(pairs[:, 0], pairs[:, 1])
            row = {"side": side, "source": "all", "measure": f"p_against_{REFERENCE}", "value": value}
            yield about[task, split, side, model, seed], {**row, "count": len(bodies)}


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
