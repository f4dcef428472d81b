"""Predictions as sounds and errors: only frequencies differ, and the numbers are those of plain formulas."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_results import DAMPING, OBJECTS, Made, fast_intervals  # noqa: E402

from vibraverse.config.learn import Learn  # noqa: E402
from vibraverse.learn.baselines.rows import baselines  # noqa: E402
from vibraverse.learn.scaling import unit_hz  # noqa: E402
from vibraverse.learn.tasks import samples_and_sides, task_at  # noqa: E402
from vibraverse.report.learning import listening  # noqa: E402
from vibraverse.report.learning.trained import Trained, errors_by_mode  # noqa: E402

pytestmark = pytest.mark.learn


def test_only_frequencies_differ_between_sounds():
    true = np.array([400.0, 1100.0, 3000.0, 9000.0])
    moved = true * [1.03, 0.95, 1.1, 1.2]
    made = listening.sounds(true, {"same": true, "moved": moved, "low": [1e-9, *moved[1:]]}, DAMPING)
    np.testing.assert_array_equal(made["same"], made[""])
    rate = listening.SAMPLE_RATE_HZ

    def levels(samples: np.ndarray, hz: np.ndarray) -> np.ndarray:
        """Amplitudes of decaying modes at their beginning, by least squares."""
        time = np.arange(rate // 5) / rate
        decay = 0.5 * (DAMPING["alpha_per_s"] + DAMPING["beta_s"] * (2 * np.pi * true) ** 2)
        ringing = np.sqrt((2 * np.pi * hz) ** 2 - decay**2)
        basis = np.exp(-np.outer(time, decay)) * np.sin(np.outer(time, ringing))
        found, rest, *_ = np.linalg.lstsq(basis, samples[: len(time)], rcond=None)
        assert rest < 1e-12
        return found

    amplitudes = levels(made[""], true)
    np.testing.assert_allclose(levels(made["moved"], moved), amplitudes, rtol=1e-6)
    np.testing.assert_allclose(
        amplitudes * true, amplitudes[0] * true[0], rtol=1e-4
    )  # as one over the frequency
    np.testing.assert_allclose(levels(made["low"], moved)[1:], amplitudes[1:], rtol=1e-6)
    assert abs(levels(made["low"], moved)[0]) < 1e-6 * amplitudes[0]
    assert max(np.abs(samples).max() for samples in made.values()) == pytest.approx(10 ** (-1 / 20))


def test_what_is_hardly_heard_is_chosen_last():
    bodies = [f"b-{number:04d} solid" for number in range(40)]
    heard = {body: number % 4 == 0 for number, body in enumerate(bodies)}
    chosen = listening.chosen(
        bodies, ["steel", "wood"], lambda body, material: heard[body] and material == "wood", 6
    )
    assert len(chosen) == 6
    assert all(heard[body] and material == "wood" for body, material in chosen)
    more = listening.chosen([*bodies, "c-0000 solid"], ["steel", "wood"], lambda *_: True, 6)
    assert len(set(more) & set(listening.chosen(bodies, ["steel", "wood"], lambda *_: True, 6))) >= 5
    ring = {**DAMPING, "alpha_per_s": 500.0}
    assert listening.is_heard(np.array([500.0]), DAMPING)
    assert not listening.is_heard(np.array([15_000.0]), DAMPING)
    assert not listening.is_heard(np.array([500.0]), ring)


def test_the_mean_spectrum_is_the_baseline_of_that_name(tmp_path):
    made = Made(tmp_path).data(OBJECTS)
    options = Learn().run("frequencies", "object", "published", 0)
    splits = made.folder / "dataset/splits.tsv"
    samples, sides = samples_and_sides(made.features, splits, options)
    mean = np.exp(listening.mean_log_omega(samples, sides["train"]))
    task = task_at(made.features, splits, options)
    volume = samples.rows("volume_m3", sides["test"])
    found = np.stack(
        [
            mean * unit_hz(volume, one["young_pa"], one["density_kg_m3"])[:, None]
            for one in samples.materials.values()
        ],
        axis=1,
    )
    with fast_intervals():
        own = {
            row["measure"]: row["value"]
            for row in task.judge(sides["test"], {"found_hz": found})
            if row["source"] == "all"
        }
        fitted = next(one for name, _, one in baselines(task) if name == "mean spectrum")
    baseline = {
        row["measure"]: row["value"] for row in fitted.rows if (row["source"], row["side"]) == ("all", "test")
    }
    assert own == pytest.approx(baseline, rel=1e-9)


def test_errors_by_mode():
    true = np.full((2, 1, 3), 100.0)
    off = np.array([[[0.01, 0.2, 0.0]], [[0.03, 0.4, 0.0]]])

    def trained(split: str, error: np.ndarray) -> Trained:
        about = {"task": "frequencies", "model": "m", "split": split, "seed": 0}
        return Trained(about, {}, {"test/found_hz": true * (1 + error), "test/true_hz": true})

    found = errors_by_mode([trained("object", off), trained("family-0", off), trained("family-1", -3 * off)])
    np.testing.assert_allclose(found["m", False][50], [0.02, 0.3, 0.0], atol=1e-12)
    # The mean over folds; one below -100 % counts as the smallest positive frequency.
    np.testing.assert_allclose(found["m", True][50], [0.04, (0.3 + (0.6 + 0.99999) / 2) / 2, 0.0], atol=1e-9)
    np.testing.assert_allclose(found["m", False][90], [0.028, 0.38, 0.0], atol=1e-12)
