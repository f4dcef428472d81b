"""What the page says beside its rows: counts, materials, how the dataset was made, validation, times, publication."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from statistics import median

from vibraverse import __version__
from vibraverse.dataset.publish.card import LIMITS, cite, licences
from vibraverse.dataset.split.assignment import emptiness
from vibraverse.flow.steps import VERSIONS

#: Loading the dataset, as the page of a published one shows it.
_LOADER = """\
import vibraverse.dataset

with vibraverse.dataset.open("{folder}") as reader:
    for sample in reader.where({chosen}):
        print(sample["object"], sample["solidity"], sample["frequencies_hz"][0])
"""
#: Names of a material's parameters on the page, with those of the dataset.
PARAMETERS = {
    "density": "density_kg_m3",
    "young": "young_pa",
    "poisson": "poisson",
    "alpha": "alpha_per_s",
    "beta": "beta_s",
}


def facts(record: Mapping, options) -> dict:
    """Return what ``dataset.json`` says, as the page reads it; ``options`` are those of the stage ``report``.

    A page of kind ``dataset`` states how to cite and load the dataset, and names no folder of a machine.
    """
    published = options.kind == "dataset"
    said = {
        "title": options.title,
        "kind": options.kind,
        "version": __version__,
        "counts": record["counts"],
        "splits": record["objects_by_split"],
        "empty_splits": emptiness(record["objects_by_split"]),
        "materials": [
            {"name": name, **{key: values[stored] for key, stored in PARAMETERS.items()}}
            for name, values in record["materials"].items()
        ],
        "stages": {
            name: _flattened(record["made_by"][name]) for name in VERSIONS if name in record["made_by"]
        },
        "shards": record["shards"],
    }
    if published:
        said["publication"] = _publication(record, options.card)
    return said


def times(costs: Mapping[str, Mapping[str, float]]) -> dict[str, dict]:
    """Return computing times from CPU seconds by object and stage.

    ``stages`` holds jobs, total and median CPU seconds of each stage in the order of the chain; the jobs of a stage for
    one object, such as solid and hollow, count as one. ``objects`` holds the total of each object and the stage that
    took most of it.
    """
    by_stage: dict[str, list[float]] = {}
    for cost in costs.values():
        for stage, seconds in cost.items():
            by_stage.setdefault(stage, []).append(seconds)
    stages = {
        name: [len(by_stage[name]), round(sum(by_stage[name]), 1), round(median(by_stage[name]), 2)]
        for name in VERSIONS
        if name in by_stage
    }
    objects = {
        name: [round(sum(cost.values()), 1), max(cost, key=cost.__getitem__)]
        for name, cost in costs.items()
        if cost
    }
    return {"stages": stages, "objects": objects}


def _publication(record: Mapping, card) -> dict:
    splits = [name for name, count in record["objects_by_split"].items() if count]
    split = "train" if "train" in splits else next(iter(splits), "")
    chosen = {"split": split, "material": next(iter(record["materials"]), "")}
    return {
        "name": card.name,
        "description": card.description,
        "version": card.version,
        "url": card.url or "",
        "published": card.published or "",
        "licences": licences(record, card),
        "citation": cite(card),
        "loader": _LOADER.format(
            folder="dataset", chosen=", ".join(f'{key}="{value}"' for key, value in chosen.items() if value)
        ),
        "limits": LIMITS,
    }


def _flattened(made_by: Mapping) -> dict:
    """Return a stage's provenance with nested options as flat pairs; materials have a table of their own."""
    options = made_by["options"]
    if isinstance(options, dict):
        options = {key: value for key, value in options.items() if key != "materials"}
    return {
        "version": made_by["stage_version"],
        "options": list(_flat(options)),
        "libraries": list(_flat(made_by["libraries"])),
    }


def _flat(value, key: str = "") -> Iterator[tuple[str, str]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _flat(inner, f"{key}.{name}" if key else name)
    else:
        yield key, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
