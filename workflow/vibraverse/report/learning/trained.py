"""Trained models as the page of learning reads them: evaluation, curves and answers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vibraverse.learn.metrics import LOWEST
from vibraverse.learn.sides import TEST


@dataclass(frozen=True)
class Trained:
    """One training: its ``evaluation``, its ``curves`` by column, with gaps as NaN, and its ``answers``."""

    evaluation: dict
    curves: Mapping[str, np.ndarray]
    answers: Mapping[str, np.ndarray]

    @property
    def task(self) -> str:
        """The task."""
        return self.evaluation["task"]

    @property
    def model(self) -> str:
        """The model."""
        return self.evaluation["model"]

    @property
    def split(self) -> str:
        """``object``, ``shuffled-K`` or ``family-K``."""
        return self.evaluation["split"]

    @property
    def by_family(self) -> bool:
        """Whether it was tested on whole families."""
        return self.split.startswith("family")

    @property
    def predicts_frequencies(self) -> bool:
        """Whether its answers are frequencies."""
        return f"{TEST}/found_hz" in self.answers

    @property
    def retrieves(self) -> bool:
        """Whether its answers are vectors to search with."""
        return f"{TEST}/shape" in self.answers


def errors_by_mode(trainings: Iterable[Trained]) -> dict[tuple[str, bool], dict[int, np.ndarray]]:
    """Return by model and ``by_family`` the percentiles 50 and 90 of the relative error of each mode (m,).

    Each is the mean over trainings, over the tested bodies in all materials.
    """
    found: dict[tuple[str, bool], list[np.ndarray]] = {}
    for one in trainings:
        predicted, true = (one.answers[f"{TEST}/{name}_hz"] for name in ("found", "true"))
        error = np.abs(np.maximum(predicted, LOWEST) / true - 1.0).reshape(-1, true.shape[-1])
        found.setdefault((one.model, one.by_family), []).append(np.percentile(error, (50, 90), axis=0))
    return {key: dict(zip((50, 90), np.mean(values, axis=0), strict=True)) for key, values in found.items()}


def answerers(trainings: Sequence[Trained]) -> list[Trained]:
    """Return the trainings whose answers are played: of each model that of the first seed, all of one split."""
    by_split: dict[str, dict[str, Trained]] = {}
    for one in sorted(trainings, key=lambda one: one.evaluation["seed"]):
        by_split.setdefault(one.split, {}).setdefault(one.model, one)
    # "object" and "shuffled-K" sort behind "family-K".
    return list(by_split[max(by_split)].values()) if by_split else []
