"""The tables of learning as people read them: methods by side, the best of each column, how each row was made."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from vibraverse.learn.judging import WALL
from vibraverse.learn.metrics import NEAR, WITHIN
from vibraverse.learn.ranking import CUTOFFS
from vibraverse.learn.sides import HELD_OUT, TEST
from vibraverse.report import quantities

#: Kinds of methods, in the order of the rows.
KINDS = ("published", "model", "control", "baseline")
#: The preset whose trainings are toys.
TOY = "tiny"


@dataclass(frozen=True)
class Measure:
    """A column: the name of a measure in the results, its title, its unit, and whether less is better.

    Values with ``percent`` are shares.
    """

    name: str
    title: str
    unit: str = ""
    less_is_better: bool | None = None
    percent: bool = False

    def text(self, value: float) -> str:
        """Return a value as people read it."""
        if not math.isfinite(value):
            return "–"
        return quantities.number(100 * value if self.percent else value)


#: The columns of each task; a task that is not listed shows all its measures.
MEASURES = {
    "frequencies": (
        Measure("median", "median error", "%", True, percent=True),
        Measure("p90", "90th percentile", "%", True, percent=True),
        Measure("median_modes_1", "mode 1, median", "%", True, percent=True),
        Measure("cents_mode_1", "mode 1", "cents", True),
        *(
            Measure(
                f"first_8_within_{bound:.0%}",
                f"within {100 * bound:g} %",
                "of bodies, %",
                False,
                percent=True,
            )
            for bound in WITHIN
        ),
    ),
    "solidity": (Measure("accuracy", "accuracy", "%", False, percent=True),),
    "reconstruction": (
        Measure("band_error", "error near the surface", "of 1.8", True),
        Measure("iou", "IoU", "%", False, percent=True),
        Measure("chamfer", "Chamfer, median", "of 1.8", True),
        *(Measure(f"f_{share:.0%}", f"F at {share:.0%}", "%", False, percent=True) for share in NEAR),
        Measure("normals", "normals", "", False),
        Measure("volume_error", "volume, median error", "%", True, percent=True),
        Measure("frequency_error", "frequencies, median error", "%", True, percent=True),
        Measure("failed", "no solid", "of bodies, %", True, percent=True),
        Measure("empty", "empty", "of bodies, %", True, percent=True),
        Measure("seconds", "time", "s per body", True),
    ),
    "cavity": (
        Measure("t_error", "error of t, mean", "", True),
        Measure(f"t_within_{WALL:g}", f"within {WALL:g}", "of bodies, %", False, percent=True),
    ),
    "retrieval": (
        Measure("mean_map", "mean average precision", "%", False, percent=True),
        *(Measure(f"mean_top_{cutoff}", f"top {cutoff}", "%", False, percent=True) for cutoff in CUTOFFS),
        Measure("mean_median_rank", "median place", "", True),
        Measure("pool", "pool", "bodies"),
    ),
}


@dataclass(frozen=True)
class Side:
    """What methods are tested on: rows of one split and side of the results."""

    title: str
    words: str
    split: str
    side: str


SIDES = (
    Side("By object", "siblings of the family were seen in training", "object", TEST),
    Side("By object, in folds", "siblings seen; every object is tested once", "shuffled", TEST),
    Side("By family", "whole families unseen", "family", TEST),
    Side("Held-out origins", "origins that training never sees", "object", HELD_OUT),
    # Shown where there are none of the split by object.
    Side("Held-out origins, trained by family", "origins that training never sees", "family", HELD_OUT),
)


def tasks(rows: Iterable[dict]) -> list[str]:
    """Return the tasks of results in their order."""
    return list(dict.fromkeys(row["task"] for row in rows))


def methods(rows: list[dict], task: str) -> list[dict]:
    """Return a row for each method of a task: published, models, controls, baselines, and the best of each first.

    The best is by the first column on the first side that has rows.
    """
    chosen = _of_all_bodies(rows, task)
    first = measures(rows, task)[0]
    found: dict[str, tuple] = {}
    for side in SIDES:
        for row in chosen:
            if (row["split"], row["side"], row["measure"]) == (side.split, side.side, first.name):
                value = row["value"] if first.less_is_better else -row["value"]
                found.setdefault(row["model"], (KINDS.index(row["kind"]), value, row))
    return [row for _, _, row in sorted(found.values(), key=lambda one: (*one[:2], one[2]["model"]))]


def measures(rows: list[dict], task: str) -> tuple[Measure, ...]:
    """Return the columns of a task."""
    return MEASURES.get(task) or tuple(
        Measure(name, name) for name in dict.fromkeys(row["measure"] for row in _of_all_bodies(rows, task))
    )


def table(rows: list[dict], task: str, data: str) -> dict:
    """Return the table of a task: ``columns``, and ``sides`` with a row for each method.

    ``rows`` are those of ``results.json``, ``data`` is the beginning of the dataset's checksum. Rows of other data are
    marked, and are never the best.
    """
    columns, order = measures(rows, task), methods(rows, task)
    found = []
    for side in SIDES:
        at = {
            (row["model"], row["measure"]): row
            for row in _of_all_bodies(rows, task)
            if (row["split"], row["side"]) == (side.split, side.side)
        }
        lines = []
        for method in order:
            values = [at.get((method["model"], column.name)) for column in columns]
            if any(values):
                lines.append(_line(method, values, columns, data))
        if not lines or (side.side == HELD_OUT and any(one["side"].side == HELD_OUT for one in found)):
            continue
        for number, column in enumerate(columns):
            _mark_best([line for line in lines if not line["strange"]], number, column)
        counts = {line["count"] for line in lines}
        found.append({"side": side, "lines": lines, "count": max(counts)})
    published = any(one["kind"] == "published" for one in order)
    return {
        "task": task,
        "columns": columns,
        "sides": found,
        "published": published,
        "toy": any(map(is_toy, order)),
    }


def is_toy(row: dict) -> bool:
    """Return whether a row of results holds a toy run."""
    return TOY in row["preset"].split(", ")


def strangers(rows: list[dict], data: str) -> dict[str, list[str]]:
    """Return the methods whose results are of other data than ``data``: by checksum, their names."""
    found: dict[str, set[str]] = {}
    for row in rows:
        if row["data_sha256"] != data:
            for one in row["data_sha256"].split(", "):
                found.setdefault(one, set()).add(row["model"])
    found.pop(data, None)
    return {one: sorted(names) for one, names in sorted(found.items())}


def making(rows: list[dict], task: str, data: str) -> list[dict]:
    """Return how each method was made: a row for each split, in the order of the table."""
    found = {
        (row["model"], row["split"]): {**row, "toy": is_toy(row), "strange": row["data_sha256"] != data}
        for row in _of_all_bodies(rows, task)
        if row["side"] == TEST
    }
    names = [one["model"] for one in methods(rows, task)]
    splits = [side.split for side in SIDES if side.side == TEST]
    return [found[name, split] for name in names for split in splits if (name, split) in found]


def _of_all_bodies(rows: list[dict], task: str) -> list[dict]:
    return [row for row in rows if row["task"] == task and row["source"] == "all"]


def _line(method: dict, values: list[dict | None], columns, data: str) -> dict:
    """Return a row of the table from the values of its columns, some of which may be None."""
    there = [row for row in values if row]
    return {
        "name": method["model"],
        "kind": method["kind"],
        "toy": any(map(is_toy, there)),
        "strange": any(row["data_sha256"] != data for row in there),
        "count": there[0]["count"],
        "minutes": there[0]["minutes"],
        "cells": [_cell(row, column) if row else None for row, column in zip(values, columns, strict=True)],
    }


def _cell(row: dict, column: Measure) -> dict:
    ends = [column.text(row[end]) for end in ("low", "high")]
    meaning = (
        "95 % interval" if row["trainings"] == 1 else f"smallest and largest of {row['trainings']} trainings"
    )
    return {
        "measure": column.name,
        "value": row["value"],
        "text": column.text(row["value"]),
        "interval": ends if ends[0] != ends[1] else [],
        "meaning": meaning,
        "best": False,
    }


def _mark_best(lines: list[dict], number: int, column: Measure) -> None:
    cells = [line["cells"][number] for line in lines if line["cells"][number]]
    values = {cell["value"] for cell in cells}
    if column.less_is_better is None or len(values) < 2:
        return
    best = min(values) if column.less_is_better else max(values)
    for cell in cells:
        cell["best"] = cell["value"] == best
