"""The impulse response against its formula, its spectrum, its decay; strikes at surface points."""

from __future__ import annotations

import decimal
from decimal import Decimal

import numpy as np
import pytest

from vibraverse.physics.impulse import FADE_S, MIN_S, contact, impact_sound, strike_weights

RATE = 44_100


def rayleigh(frequencies_hz, alpha=6.0, beta=1e-7):
    return 0.5 * (alpha + beta * (2 * np.pi * np.asarray(frequencies_hz)) ** 2)


@pytest.fixture(scope="module")
def modes():
    frequencies = np.sort(np.random.default_rng(3).uniform(400, 18_000, 64))
    return frequencies, rayleigh(frequencies)


def test_equals_the_formula(modes):
    frequencies, damping = modes
    weights = np.random.default_rng(4).normal(size=64)
    sound = impact_sound(frequencies, damping, RATE, weights=weights)
    omega = 2 * np.pi * frequencies
    ringing = np.sqrt(omega**2 - damping**2)
    time = np.arange(len(sound.samples)) / RATE
    expected = np.zeros_like(time)
    for w, d, o in zip(weights, damping, ringing, strict=True):
        expected += w * np.exp(-d * time) * np.sin(o * time) / o
    before_fade = slice(0, len(time) - round(FADE_S * RATE))
    error = np.abs(sound.samples - expected)[before_fade]
    assert error.max() <= 1e-12 * np.abs(expected).max()
    assert abs(sound.samples[-1]) <= 1e-6 * np.abs(expected).max()


def test_spectrum_peaks_where_the_modes_are():
    frequencies = np.array([440.0, 1234.5, 2750.0, 6001.0, 11_111.0, 17_890.0])
    sound = impact_sound(frequencies, np.full(6, 3.0), RATE, max_s=2.0, weights=2 * np.pi * frequencies)
    spectrum = np.abs(np.fft.rfft(sound.samples * np.hanning(len(sound.samples))))
    bin_hz = RATE / len(sound.samples)
    for frequency in frequencies:
        near = np.arange(int((frequency - 60) / bin_hz), int((frequency + 60) / bin_hz))
        assert abs(near[np.argmax(spectrum[near])] * bin_hz - frequency) <= bin_hz


def test_decays_as_damped():
    sound = impact_sound([1000.0], [25.0], RATE)
    # One period is 44.1 samples; windows of 441 samples hold ten whole ones.
    levels = np.sqrt((sound.samples[: 441 * 20].reshape(20, 441) ** 2).mean(axis=1))
    rates = -np.diff(np.log(levels)) / 0.01
    np.testing.assert_allclose(rates, 25.0, rtol=2e-4)


@pytest.mark.parametrize("decay_db", [20.0, 60.0, 90.0])
def test_lasts_until_the_envelopes_have_fallen(modes, decay_db):
    frequencies, damping = modes
    sound = impact_sound(frequencies, damping, RATE, decay_db=decay_db, max_s=10.0)
    omega = 2 * np.pi * frequencies
    envelope = np.exp(-damping * sound.duration_s) @ (1 / np.sqrt(omega**2 - damping**2))
    start = (1 / np.sqrt(omega**2 - damping**2)).sum()
    assert sound.decayed
    assert 20 * np.log10(envelope / start) == pytest.approx(-decay_db, abs=0.1)


def test_limit_and_least_length():
    endless = impact_sound([500.0], [0.0], RATE, max_s=0.7)
    assert not endless.decayed
    assert endless.duration_s == pytest.approx(0.7, abs=1 / RATE)
    short = impact_sound([5000.0], [20_000.0], RATE)
    assert short.decayed
    assert short.duration_s == pytest.approx(MIN_S, abs=1 / RATE)


def test_leaves_out_what_would_alias():
    sound = impact_sound([1000.0, 22_049.0, 22_051.0, 90_000.0], [5.0] * 4, RATE)
    assert (sound.modes_rendered, sound.modes_above_nyquist) == (2, 2)
    silent = impact_sound([30_000.0], [5.0], RATE)
    assert silent.modes_rendered == 0
    assert not silent.samples.any()
    assert silent.duration_s >= MIN_S


@pytest.mark.parametrize("ratio", [1.0, 1.0 + 1e-12, 1.5, 40.0, 1e6])
def test_overdamped_is_the_sinh_form(ratio):
    omega = 2 * np.pi * 200.0
    damping = omega * ratio
    sound = impact_sound([200.0], [damping], RATE, max_s=0.5)
    assert (sound.modes_overdamped, sound.modes_rendered) == (1, 1)
    assert np.isfinite(sound.samples).all()
    with decimal.localcontext(prec=60, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN):
        exact = Decimal(float(damping))
        gamma = (exact**2 - Decimal(float(omega)) ** 2).sqrt()
        for index in (1, 7, 100, 400):
            time = Decimal(index) / RATE
            growth = (gamma * time).exp()
            sinh = (growth - 1 / growth) / 2
            expected = (-exact * time).exp() * (sinh / gamma if gamma else time)
            assert sound.samples[index] == pytest.approx(float(expected), rel=1e-11)


def test_is_continuous_through_critical_damping():
    omega = 2 * np.pi * 300.0
    below = impact_sound([300.0], [omega * (1 - 1e-9)], RATE).samples
    above = impact_sound([300.0], [omega * (1 + 1e-9)], RATE).samples
    np.testing.assert_allclose(below[:400], above[:400], rtol=1e-6)


def test_repeats_to_the_bit(modes):
    assert impact_sound(*modes, RATE).samples.tobytes() == impact_sound(*modes, RATE).samples.tobytes()


@pytest.mark.parametrize(
    ("frequencies", "damping", "weights", "words"),
    [
        ([100.0, 200.0], [1.0], None, "one length"),
        ([100.0], [np.nan], None, "finite"),
        ([100.0], [1.0], [np.inf], "finite"),
        ([0.0], [1.0], None, "positive"),
        ([100.0], [-1.0], None, "negative"),
    ],
)
def test_refuses_nonsense(frequencies, damping, weights, words):
    with pytest.raises(ValueError, match=words):
        impact_sound(frequencies, damping, RATE, weights=weights)


CUBE = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


@pytest.mark.parametrize(
    ("point", "position", "normal"),
    [
        ((3, 0.2, 0.5), (1, 0.2, 0.5), (1, 0, 0)),
        ((0.1, 0.2, -0.9), (0.1, 0.2, -1), (0, 0, -1)),
        ((2, 2, 0.3), (1, 1, 0.3), (1, 1, 0)),
        ((4, 5, 6), (1, 1, 1), (1, 1, 1)),
        ((-4, 5, -6), (-1, 1, -1), (-1, 1, -1)),
    ],
)
def test_contact_on_face_edge_and_corner(point, position, normal):
    found = contact(CUBE, CUBE_FACES, point)
    np.testing.assert_allclose(found.position, position, atol=1e-12)
    np.testing.assert_allclose(found.normal, np.array(normal) / np.linalg.norm(normal), atol=1e-12)
    np.testing.assert_allclose(found.barycentric @ CUBE[found.corners], position, atol=1e-12)


def test_contact_is_nearest_of_many_samples():
    rng = np.random.default_rng(8)
    vertices, faces = rng.normal(size=(40, 3)), rng.integers(0, 40, (60, 3))
    faces = faces[[len(set(face)) == 3 for face in faces.tolist()]]
    mixing = rng.dirichlet(np.ones(3) * 0.6, 4000)
    samples = np.einsum("sc,fck->fsk", mixing, vertices[faces]).reshape(-1, 3)
    for point in rng.normal(size=(20, 3)) * 1.5:
        nearest = np.linalg.norm(contact(vertices, faces, point).position - point)
        sampled = np.linalg.norm(samples - point, axis=1).min()
        assert nearest <= sampled + 1e-12
        assert sampled - nearest < 0.1


def test_weights_of_a_rigid_and_a_linear_field():
    rigid = np.broadcast_to([0.3, -0.2, 0.7], CUBE.shape)
    linear = CUBE @ np.array([[1.0, 0.2, 0], [0, 2, 0.1], [0.3, 0, 3]])
    weights = strike_weights(np.stack([rigid, linear]), CUBE, CUBE_FACES, (0.4, 0.25, 5))
    assert weights == pytest.approx([0.7, (np.array([0.4, 0.25, 1]) @ [0, 0.1, 3])], abs=1e-12)


def test_contact_needs_a_face_with_an_area():
    with pytest.raises(ValueError, match="no face"):
        contact(np.zeros((3, 3)), np.array([[0, 1, 2]]), (0, 0, 1))
