"""Statistical baselines on bodies whose spectra are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vibraverse.contract.seeds import rng
from vibraverse.learn.baselines.statistics import BASELINES, Bodies
from vibraverse.physics.materials import MATERIALS

pytestmark = pytest.mark.learn
MODES = 64
NAMES = ("steel", "glass", "wood")


def bodies(shapes: int, seed: str) -> Bodies:
    """Return random shapes, each in all materials."""
    random = rng("statistics", seed)
    invariants = np.exp(random.uniform(-1, 1, (shapes, 5)))
    names = np.tile(NAMES, shapes)
    columns = (
        np.array([MATERIALS[name][key] for name in names]) for key in ("young_pa", "density_kg_m3", "poisson")
    )
    volume = np.repeat(random.uniform(1e-6, 1e-3, shapes), len(NAMES))
    unknown = np.zeros((len(names), 3, MODES))
    some = Bodies(np.repeat(invariants, len(NAMES), axis=0), unknown, volume, *columns, names)
    # Thin bodies are farther off, the more so in high modes; each degree halves the error.
    above = 0.2 * some.invariants[:, :1] * np.linspace(0.5, 1.5, MODES)
    return replace(
        some, ritz=(spectra(some) + above)[:, None] + above[:, None] * np.array([3, 1, 0])[:, None]
    )


def spectra(some: Bodies) -> np.ndarray:
    """Return ``log ω̂`` that is linear in log invariants and Poisson's ratio, with slopes that differ by mode."""
    modes = np.linspace(0, 1, MODES)
    shape = np.log(some.invariants) @ np.array([0.3, -0.2, 0.1, -0.4, 0.2])
    return np.log(2 + 10 * modes) + shape[:, None] * (1 - 0.3 * modes) + some.poisson[:, None] * (modes - 0.2)


def error(predicted: np.ndarray, true: np.ndarray) -> float:
    return float(np.median(np.abs(predicted - true)))


@pytest.fixture(scope="module")
def train():
    return bodies(150, "train")


@pytest.fixture(scope="module")
def test():
    return bodies(60, "test")


def predictor(name: str, train: Bodies, log_omega: np.ndarray):
    fast = {"trees": 60} if name.startswith("extra") else {"rounds": 60} if "boosting" in name else {}
    if fast:
        pytest.importorskip("sklearn", reason="scikit-learn belongs to the learning environment")
    return BASELINES[name](train, log_omega, **fast)


def test_scales_are_exact_and_inverse(train):
    some = train[:5]
    stiffer = replace(some, young_pa=2 * some.young_pa)
    log_omega = spectra(some)
    np.testing.assert_allclose(stiffer.hertz(log_omega), np.sqrt(2) * some.hertz(log_omega), rtol=1e-14)
    larger = replace(some, volume_m3=8 * some.volume_m3)
    np.testing.assert_allclose(larger.hertz(log_omega), 0.5 * some.hertz(log_omega), rtol=1e-14)
    np.testing.assert_allclose(some.log_omega(some.hertz(log_omega)), log_omega, atol=1e-14)
    # A cube of side L: ω̂ = ω L sqrt(ρ/E).
    expected = np.exp(log_omega) * np.sqrt(some.young_pa / some.density_kg_m3)[:, None]
    np.testing.assert_allclose(
        some.hertz(log_omega), expected / (2 * np.pi * some.volume_m3[:, None] ** (1 / 3)), rtol=1e-12
    )


def test_the_training_mean_is_the_mean_on_the_mel_scale(train, test):
    frequencies = np.tile(np.linspace(100, 9000, MODES), (len(train), 1))
    frequencies[::2] *= 2
    mels = 2595 * np.log10(1 + frequencies[:2] / 700)
    expected = 700 * (10 ** (mels.mean(axis=0) / 2595) - 1)
    predict = predictor("training mean", train, train.log_omega(frequencies))
    np.testing.assert_allclose(test.hertz(predict(test)), np.tile(expected, (len(test), 1)), rtol=1e-10)


def test_the_material_mean_knows_materials_and_falls_back(train, test):
    of_material = {name: 100.0 * (number + 1) * np.arange(1, MODES + 1) for number, name in enumerate(NAMES)}
    frequencies = np.array([of_material[name] for name in train.material])
    predict = predictor("material mean", train, train.log_omega(frequencies))
    expected = np.array([of_material[name] for name in test.material])
    np.testing.assert_allclose(test.hertz(predict(test)), expected, rtol=1e-10)
    unknown = replace(test, material=np.full(len(test), "tin"))
    overall = predictor("training mean", train, train.log_omega(frequencies))
    np.testing.assert_allclose(predict(unknown), overall(unknown), rtol=1e-12)


def test_the_mean_spectrum_is_exact_for_one_shape_in_any_size_and_material(train, test):
    spectrum = np.log(np.linspace(2, 9, MODES))
    predict = predictor("mean spectrum", train, np.tile(spectrum, (len(train), 1)))
    np.testing.assert_allclose(predict(test), np.tile(spectrum, (len(test), 1)), rtol=1e-12)


def test_the_nearest_shape_decides_and_poisson_moves_it(train):
    """A known shape in a material of another Poisson's ratio: the slope comes from the other shapes."""
    predict = predictor("nearest shapes", train, spectra(train))
    known = train[::3]
    other = replace(known, poisson=np.full(len(known), 0.35))
    np.testing.assert_allclose(predict(other), spectra(other), atol=1e-4)


def test_what_sees_the_shape_beats_the_mean_spectrum(train, test):
    true = spectra(test)
    mean = error(predictor("mean spectrum", train, spectra(train))(test), true)
    for name, share in (("nearest shapes", 0.7), ("extra trees", 0.5), ("gradient boosting", 0.5)):
        predicted = predictor(name, train, spectra(train))(test)
        assert predicted.shape == (len(test), MODES)
        assert (np.diff(predicted, axis=1) >= 0).all(), name
        assert error(predicted, true) < share * mean, name


def test_what_sees_the_ritz_frequencies_removes_their_error(train, test):
    true = spectra(test)
    ritz = error(test.ritz[:, -1], true)
    mean = predictor("finest Ritz, mean correction", train, spectra(train))(test)
    trees = predictor("extra trees on Ritz", train, spectra(train))(test)
    assert (np.diff(trees, axis=1) >= 0).all()
    assert error(mean, true) < 0.6 * ritz
    assert error(trees, true) < 0.3 * error(mean, true)
