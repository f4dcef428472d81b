"""Peaks of a sound against damped sinusoids with known parameters, and against the Cramér-Rao bound."""

from __future__ import annotations

import numpy as np
import pytest

from vibraverse.contract.errors import UsageError
from vibraverse.listening import peaks, poles
from vibraverse.listening.strikes import strike

RATE = 44_100


def ringing(frequencies_hz, decays_per_s, amplitudes, length_s, rate=RATE):
    """Return damped sinusoids: undamped frequencies, phases 0, 1, 2, … radians."""
    time = np.arange(round(length_s * rate)) / rate
    omega = 2 * np.pi * np.asarray(frequencies_hz)
    damped = np.sqrt(omega**2 - np.square(decays_per_s))
    return sum(
        a * np.exp(-d * time) * np.cos(w * time + k)
        for k, (w, d, a) in enumerate(zip(damped, decays_per_s, amplitudes, strict=True))
    )


def test_errors_of_a_pole_are_the_cramer_rao_bound():
    """One pole of modulus r in complex white noise: ``var Re s = var Im s = σ² (1 - r²)³ / (2 r² |c|²)``."""
    random, true, noise, count = np.random.default_rng(1), -0.02 + 0.7j, 0.05, 400
    found = []
    for _ in range(30):
        white = random.normal(size=(2, count)) * noise / np.sqrt(2)
        signal = np.exp(true * np.arange(count)) + white[0] + 1j * white[1]
        one = poles.find(signal)
        assert len(one.exponents) == 1
        found.append((one.exponents[0], one.error[0]))
    exponents, errors = np.array(found).T
    square = np.exp(2 * true.real)
    bound = noise * np.sqrt((1 - square) ** 3 / square / 2)
    assert errors.real == pytest.approx(bound, rel=0.15)
    assert np.std(exponents.real) == pytest.approx(bound, rel=0.4)
    assert np.std(exponents.imag) == pytest.approx(bound, rel=0.4)


def test_modes_that_last_for_milliseconds_and_for_seconds():
    frequencies = np.array([310.0, 955.0, 961.0, 2400.0, 4210.0, 6000.0, 9100.0, 15_000.0])
    decays = np.array([1.5, 6.0, 8.0, 40.0, 160.0, 600.0, 1500.0, 900.0])
    amplitudes = np.array([0.3, 1.0, 0.8, 0.5, 0.6, 1.0, 1.0, 0.7])
    signal = ringing(frequencies, decays, amplitudes, 0.8)
    noise = 1e-3 * np.random.default_rng(2).normal(size=len(signal))
    found = peaks.find(signal + noise, RATE)
    nearest = np.abs(np.log(found.frequency_hz[:, None] / frequencies)).argmin(axis=0)
    assert len(set(nearest)) == len(frequencies)
    assert len(found) <= len(frequencies) + 1
    off = found.frequency_hz[nearest] - frequencies
    assert np.abs(off / frequencies).max() < 1e-3
    assert (np.abs(off) < 4.5 * found.frequency_error_hz[nearest]).all()
    assert (np.abs(found.decay_per_s[nearest] - decays) < 4.5 * found.decay_error_per_s[nearest]).all()
    assert found.amplitude[nearest] == pytest.approx(amplitudes, rel=0.1)


def test_noise_alone_has_hardly_a_peak():
    noise = np.random.default_rng(3).normal(size=RATE // 4)
    assert len(peaks.find(noise, RATE)) <= 3


# The hit in a recording


def hit(length_s=0.6, level=0.5):
    return level * ringing(
        [700.0, 1830.0, 3400.0, 5200.0], [20.0, 30.0, 45.0, 80.0], [0.3, 0.4, 0.2, 0.1], length_s
    )


def recorded(*parts, noise=1e-4, seed=5):
    whole = np.concatenate(parts)
    return (whole + noise * np.random.default_rng(seed).normal(size=len(whole)))[:, None]


def test_the_first_of_several_hits_is_used_up_to_the_second():
    silence = np.zeros(RATE // 4)
    found = strike(recorded(silence, hit(0.4), 0.6 * hit(0.8)), RATE)
    assert found.start_s == pytest.approx(0.25, abs=2e-3)
    assert len(found.samples) / RATE == pytest.approx(0.4, abs=0.02)
    assert found.notes == ["there are 2 hits, at 0.250, 0.650 s; the first is used, for 0.392 s"]


def test_beats_are_no_hits():
    beating = ringing([700.0, 706.0, 1500.0, 1509.0], [2.0, 2.0, 3.0, 3.0], [1.0, 1.0, 0.7, 0.7], 1.5)
    assert strike(recorded(0.3 * beating), RATE).notes == []


def test_the_loudest_channel_is_used():
    """Their sum would be silent."""
    left = recorded(hit())[:, 0]
    found = strike(np.stack([0.9 * left, -left], axis=1), RATE)
    assert found.notes == ["channel 2 of 2 is used, the loudest"]
    assert np.abs(found.samples).max() == pytest.approx(np.abs(left).max(), rel=0.05)


@pytest.mark.parametrize(
    ("recording", "rate", "sentence"),
    [
        (np.zeros((RATE, 1)), RATE, "the recording is silent, its loudest sample is zero; record louder"),
        (1e-5 * hit()[:, None], RATE, "silent, its loudest sample is 1"),
        (np.clip(4 * hit(), -0.5, 0.5)[:, None], RATE, "the recording is clipped: "),
        (
            hit()[::20, None],
            RATE // 20,
            "the sample rate of 2205 Hz is too low: nothing above 1102.5 Hz is in the",
        ),
        (hit(0.015)[:, None], RATE, "lasts 3 ms, at least 8 are needed; record until it has died away"),
        (np.full((RATE, 1), np.nan), RATE, "samples that are not finite"),
    ],
)
def test_a_recording_of_no_use_is_one_sentence(recording, rate, sentence):
    with pytest.raises(UsageError) as raised:
        strike(recording, rate)
    assert sentence in str(raised.value)


def test_a_slow_sample_rate_is_said():
    (note,) = strike(hit()[::5, None], 8820).notes
    assert note == "the sample rate is 8820 Hz, so nothing above 4410 Hz is heard; record at 44100 Hz"


def test_a_loud_sine_is_not_taken_for_clipped():
    strike(0.999 * ringing([200.0], [0.1], [1.0], 1.0)[:, None], RATE)
