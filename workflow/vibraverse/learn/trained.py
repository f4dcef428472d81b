"""A finished training of the task ``frequencies``: what its record says, and how wrong its model was.

Errors are those that ``evaluate`` found on bodies that training had not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vibraverse.config import ConfigError, validate
from vibraverse.config.learn import FAMILY, OBJECT, RunOptions
from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.flow.steps import BY_NAME
from vibraverse.learn.facts import identity
from vibraverse.learn.metrics import LOWEST
from vibraverse.learn.results import config_hash
from vibraverse.learn.samples import Layout
from vibraverse.learn.sides import TEST
from vibraverse.learn.tasks import OWN

#: The task whose models give frequencies.
TASK = "frequencies"
#: So much in percent of the modes of unseen bodies lies within the error bars.
COVERED = 90
MODEL, RECORD, ANSWERS, METRICS = (
    Path(BY_NAME[step].outputs[output].path).name
    for step, output in (
        ("train", "model"),
        ("train", "record"),
        ("evaluate", "answers"),
        ("evaluate", "record"),
    )
)


@dataclass(frozen=True)
class TrainedModel:
    """A trained model in the folder of its training."""

    folder: Path
    record: dict
    options: RunOptions
    layout: Layout

    @property
    def sha256(self) -> str:
        """The checksum of the weights, as the training states it."""
        return self.record["provenance"]["output_sha256"]["model"]

    @property
    def validation(self) -> float:
        """The median error on the bodies that chose the best weights; infinity if it is not a number."""
        median = float(self.record["metrics"]["best"]["validation"]["median"])
        return median if np.isfinite(median) else np.inf


def read(folder: str | Path) -> TrainedModel:
    """Return the model of a training; raise :class:`UsageError` if it cannot be used here."""
    path = Path(folder) / RECORD
    if wrong := unreadable(path, missing=f"name the folder of a training, which holds {MODEL} and {RECORD}"):
        raise UsageError(f"the record of the model, {path}, {wrong}")
    broken = f"{path} is not the record of a training, or is damaged; copy the folder again, or train anew"
    try:
        record = products.read_json(path)
        made, version = record["provenance"], record["provenance"]["stage_version"]
        task = made["options"]["task"]
    except (ValueError, LookupError, TypeError):
        raise UsageError(broken) from None
    if task != TASK:
        raise UsageError(
            f"{folder} holds a model of the task {task!r}, which gives no frequencies; name one of the task {TASK!r}"
        )
    if (task, made["options"]["model"]) in OWN:
        raise UsageError(
            f"{folder} holds the model {made['options']['model']!r}, which takes a body's tetrahedra; name another "
            "model, or simulate the mesh (`vibraverse strike`)"
        )
    if version != BY_NAME["train"].version:
        raise UsageError(
            f"{path} was written by version {version} of the stage train, and this is version "
            f"{BY_NAME['train'].version} (vibraverse {made['vibraverse']} wrote it); run the same `snakemake learn` "
            "again, which trains anew"
        )
    try:
        model = TrainedModel(
            Path(folder), record, validate(RunOptions, made["options"]), Layout(**record["features"])
        )
        _ = model.sha256, model.validation
    except (ConfigError, LookupError, TypeError, ValueError):
        raise UsageError(broken) from None
    return model


@dataclass(frozen=True)
class ErrorBars:
    """Factors (m,) from a predicted frequency to the ends of its error bar, and what they were measured on.

    ``split`` is ``family`` where the bodies are of families that their training had not seen, else ``object``.
    """

    low: np.ndarray
    high: np.ndarray
    split: str
    bodies: int
    trainings: int

    def measured_on(self) -> dict:
        """Return what the error bars were measured on."""
        return {"split": self.split, "bodies": self.bodies, "trainings": self.trainings}


def error_bars(model: TrainedModel, solidity: str) -> ErrorBars | None:
    """Return the error bars of a model, measured on bodies of this solidity if there were any; None without answers.

    Siblings of a family differ in a few numbers, so errors by object are too small for a shape of a new kind. Where
    trainings by family with the same options and data lie beside the model's, theirs are taken.
    """
    split = FAMILY
    answered = [folder for folder in _by_family(model.folder) if _is_alike(folder, model)]
    if not answered and _evaluated(model.folder, model):
        split, answered = OBJECT, [model.folder]
    ratios, bodies = [], set()
    for folder in answered:
        with np.load(folder / ANSWERS) as answers:
            names = answers[f"{TEST}/body"]
            same = np.char.endswith(names, f" {solidity}")
            mask = same if same.any() else np.ones_like(same)
            found, true = (answers[f"{TEST}/{name}"][mask] for name in ("found_hz", "true_hz"))
        ratios.append((np.log(np.maximum(found, LOWEST)) - np.log(true)).reshape(-1, found.shape[-1]))
        bodies |= set(names[mask].tolist())
    if not ratios:
        return None
    outside = 0.5 * (100 - COVERED)
    low, high = np.percentile(np.concatenate(ratios), [outside, 100 - outside], axis=0)
    return ErrorBars(np.exp(-high), np.exp(-low), split, len(bodies), len(ratios))


def _by_family(folder: Path) -> list[Path]:
    """Return the folders of all trainings by family of the same model, which lie beside that of its split."""
    seed = folder.resolve()
    return (
        sorted(seed.parents[2].glob(f"{FAMILY}-*/{seed.parent.name}/seed-*")) if len(seed.parents) > 2 else []
    )


def _is_alike(folder: Path, model: TrainedModel) -> bool:
    """Return whether a training has answers, and its options and data are those of a model."""
    data = identity(model.record["provenance"]["input_sha256"]["features"])
    metrics = _metrics(folder)
    expected = (TASK, config_hash(model.options, model.options.model), data)
    return tuple(metrics.get(key) for key in ("task", "config_hash", "data_sha256")) == expected


def _evaluated(folder: Path, model: TrainedModel) -> bool:
    """Return whether the answers in a folder are those of a model's own weights."""
    stated = _metrics(folder).get("provenance", {}).get("input_sha256", {})
    return stated.get("model") == model.sha256


def _metrics(folder: Path) -> dict:
    """Return the record of an evaluation; empty without one, and without its answers."""
    if unreadable(folder / METRICS) or unreadable(folder / ANSWERS):
        return {}
    try:
        return products.read_json(folder / METRICS)
    except ValueError:
        return {}
