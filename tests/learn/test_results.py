"""Measures, and the table of all models."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from vibraverse.config.learn import Learn
from vibraverse.learn.judging import Judgement
from vibraverse.learn.metrics import mcnemar
from vibraverse.learn.results import evaluation, table

pytestmark = pytest.mark.learn
MADE = {"input_sha256": {"features": {"features": "abc"}}, "vibraverse": "0"}
ABOUT = {"kind": "model", "preset": "cpu", "hardware": "here", "threads": 1, "minutes": 1.0}


def answered(model: str, split: str, right: list[bool], seed: int = 0) -> dict:
    """Return the evaluation of a classifier that was right or wrong about some bodies."""
    names = [f"{split} {number}" for number in range(len(right))]
    row = {
        "side": "test",
        "source": "all",
        "measure": "accuracy",
        "value": np.mean(right),
        "count": len(right),
    }
    found = Judgement(rows=[row], right={"test": dict(zip(names, right, strict=True))})
    return evaluation(Learn().run("solidity", split, model, seed), model, found, ABOUT, MADE)


def test_mcnemars_test_looks_at_the_samples_on_which_two_differ():
    one = np.array([True] * 10 + [False] * 2 + [True] * 50 + [False] * 7)
    other = np.array([False] * 10 + [True] * 2 + [True] * 50 + [False] * 7)
    assert mcnemar(one, other) == mcnemar(other, one) == pytest.approx(2 * binom.cdf(2, 12, 0.5))
    assert mcnemar(one, one) == 1.0


def test_models_are_compared_with_the_published_one_over_all_folds():
    published = [[True] * 6 + [False] * 4, [True] * 5 + [False] * 5]
    better = [[True] * 10, [True] * 5 + [False] * 5]
    made = [
        answered(model, f"shuffled-{fold}", right[fold], seed)
        for model, right in (("published", published), ("ratios", better))
        for fold in (0, 1)
        for seed in (0, 1)
    ]
    rows = {
        (row["model"], row["measure"]): row for row in table([*made, answered("trees", "object", [True])])
    }
    compared = rows["ratios", "p_against_published"]
    assert compared["value"] == pytest.approx(2 * 0.5**4)
    assert (compared["count"], compared["trainings"], compared["split"]) == (20, 2, "shuffled")
    assert ("published", "p_against_published") not in rows
    assert ("trees", "p_against_published") not in rows  # no published model on this split
    assert rows["ratios", "accuracy"]["value"] == pytest.approx(0.75)
