"""The half-sine contact against numerical integration, and its limits: impulse, resonance, critical damping."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from vibraverse.physics.half_sine import contact_motion, impulse_motion
from vibraverse.physics.impulse import FADE_S, MIN_S, OBSERVABLES, impact_sound

RATE = 44_100
#: A contact of 2 ms has p = 500π; modes around it, far from it, and with damping up to a thousand times critical.
CONTACT_S = 2e-3
PUSH = np.pi / CONTACT_S
OMEGA = PUSH * np.array([0.01, 0.3, 1, 1, 1, 1 + 1e-9, 1 - 1e-5, 1.01, 3, 2.5, 60, 1, 1, 1, 0.2, 5, 0.5])
DAMPING = OMEGA * np.array(
    [0.01, 0.5, 0, 1e-12, 1e-6, 1e-3, 0, 0.1, 0.95, 0, 1e-4, 1, 1.001, 0.999999, 1e3, 30, 0]
)


def exact(omega: float, damping: float, time_s: float, contact_s: float = CONTACT_S) -> np.ndarray:
    """Return displacement, velocity and acceleration by the matrix exponential of mode and force together."""
    push = np.pi / contact_s
    pressed = min(time_s, contact_s)
    system = np.array(
        [[0, 1, 0, 0], [-(omega**2), -2 * damping, 1, 0], [0, 0, 0, push], [0, 0, -push, 0]], np.float64
    )
    state = expm(system * pressed) @ [0, 0, 0, push / 2]
    if time_s > contact_s:
        state[:2], state[2] = expm(system[:2, :2] * (time_s - contact_s)) @ state[:2], 0.0
    return np.array([state[0], state[1], state[2] - 2 * damping * state[1] - omega**2 * state[0]])


def test_the_contact_is_the_exponential_of_mode_and_force():
    time_s = np.linspace(0, CONTACT_S, 37)
    found = contact_motion(OMEGA, DAMPING, CONTACT_S, time_s)
    for mode, (omega, damping) in enumerate(zip(OMEGA, DAMPING, strict=True)):
        expected = np.array([exact(omega, damping, time) for time in time_s]).T
        error = np.abs(found[:, mode] - expected).max(axis=1) / np.abs(expected).max(axis=1)
        assert error.max() < 3e-10, (omega / PUSH, damping / omega, error)


@pytest.mark.parametrize(("omega", "damping"), [(1.0, 0.02), (4.0, 0.5), (1.0, 1.0), (0.7, 3.0)])
def test_the_contact_is_the_integral_of_its_force(omega, damping):
    omega, damping = omega * PUSH, damping * PUSH
    time_s = np.linspace(0, CONTACT_S, 21)

    def moves(time, state):
        return [state[1], PUSH / 2 * np.sin(PUSH * time) - 2 * damping * state[1] - omega**2 * state[0]]

    expected = solve_ivp(moves, (0, CONTACT_S), [0, 0], "DOP853", time_s, rtol=1e-12, atol=1e-18).y
    found = contact_motion(np.array([omega]), np.array([damping]), CONTACT_S, time_s)[:2, 0]
    assert (np.abs(found - expected).max(axis=1) < 1e-10 * np.abs(expected).max(axis=1)).all()


def test_after_the_contact_a_mode_rings_with_the_stated_weight():
    """The two ways to write the weight in the docstring, and the motion at the end of the contact, are one."""
    omega, damping = PUSH * np.array([0.3, 1.7, 12.0]), PUSH * np.array([0.1, 0.02, 0.3])
    s = -damping + 1j * np.sqrt(omega**2 - damping**2)
    z = (s - 1j * PUSH) * CONTACT_S
    weight = -np.pi * PUSH / (2 * s.imag) * np.expm1(z) / z / (s + 1j * PUSH)
    by_start = PUSH**2 / 2 * (1 + np.exp(-s * CONTACT_S)) / (s**2 + PUSH**2) * np.exp(s * CONTACT_S) / s.imag
    np.testing.assert_allclose(by_start, weight, rtol=1e-12)
    place, speed, _ = contact_motion(omega, damping, CONTACT_S, np.array([CONTACT_S]))[:, :, 0]
    np.testing.assert_allclose(place, weight.imag, rtol=1e-11)
    np.testing.assert_allclose(speed, (weight * s).imag, rtol=1e-11)


def test_the_motion_after_an_impulse_starts_at_rest_with_unit_speed():
    place, speed = impulse_motion(OMEGA, DAMPING, np.zeros(len(OMEGA)))
    assert not place.any()
    np.testing.assert_allclose(speed, 1.0, rtol=1e-15)


@pytest.mark.parametrize("observable", OBSERVABLES)
@pytest.mark.parametrize("contact_s", [3e-5, 1e-3, 0.0101])
def test_a_sound_is_the_motion_of_its_modes(observable, contact_s):
    omega = 2 * np.pi * np.array([90.0, 500.0, 2500.0, 9000.0, 300.0, 40.0])
    damping = np.array([20.0, 60.0, 90.0, 200.0, 1900.0, 5000.0])
    weights = np.array([1.0, -0.4, 0.3, 0.8, -2.0, 0.5])
    sound = impact_sound(
        omega / 2 / np.pi, damping, RATE, weights=weights, contact_s=contact_s, observable=observable
    )
    expected, found = [], []
    for index in [*range(0, 40, 3), *range(40, len(sound.samples) - round(FADE_S * RATE), 97)]:
        motions = [exact(*mode, index / RATE, contact_s) for mode in zip(omega, damping, strict=True)]
        expected.append(weights @ np.array(motions)[:, OBSERVABLES[observable]])
        found.append(sound.samples[index])
    assert len(found) > 40
    assert np.abs(np.subtract(found, expected)).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.parametrize("observable", OBSERVABLES)
def test_a_short_contact_is_an_impulse(observable):
    modes = [400.0, 2000.0, 150.0], [9.0, 40.0, 1500.0]
    struck = impact_sound(*modes, RATE, observable=observable).samples[2:4000]
    previous = np.inf
    for contact_s in (1e-5, 1e-6, 1e-7):
        # The middle of the contact stands for the impulse.
        pressed = impact_sound(*modes, RATE, contact_s=contact_s, observable=observable).samples[2:4000]
        error = np.abs(pressed - struck).max() / np.abs(struck).max()
        assert error < 0.2 * previous
        previous = error
    assert previous < 2e-3


def test_velocity_and_acceleration_are_derivatives():
    """By differences between samples of an impulse's sound, which shrink with the square of the step."""
    modes = [120.0, 333.0], [9.0, 40.0]
    rate = 96_000
    place, speed, rise = (impact_sound(*modes, rate, observable=each).samples[:5000] for each in OBSERVABLES)
    for whole, derivative in ((place, speed), (speed, rise)):
        differences = (whole[2:] - whole[:-2]) * rate / 2
        assert np.abs(differences - derivative[1:-1]).max() < 2e-4 * np.abs(derivative).max()


def test_two_strikes_are_the_sum_of_their_sounds():
    """Two pulses of force, the second while the mode still rings, integrated as one motion."""
    omega, damping, contact_s = 2 * np.pi * 300.0, 40.0, 1e-3
    push, gap = np.pi / contact_s, 500
    one = impact_sound([300.0], [damping], RATE, contact_s=contact_s).samples
    both = one[: 2 * gap].copy()
    both[gap:] += 0.5 * one[:gap]

    def moves(time, state):
        force = sum(
            size * push / 2 * np.sin(push * (time - start)) * (0 <= time - start <= contact_s)
            for start, size in ((0.0, 1.0), (gap / RATE, 0.5))
        )
        return [state[1], force - 2 * damping * state[1] - omega**2 * state[0]]

    time_s = np.arange(2 * gap) / RATE
    integrated = solve_ivp(
        moves, (0, time_s[-1]), [0, 0], "DOP853", time_s, rtol=1e-10, atol=1e-14, max_step=contact_s / 20
    ).y[0]
    assert np.abs(both - integrated).max() < 1e-6 * np.abs(integrated).max()


def test_a_sound_ends_by_its_ring_after_the_contact():
    struck = impact_sound([800.0], [30.0], RATE)
    for contact_s in (0.5e-3, 5e-3):
        pressed = impact_sound([800.0], [30.0], RATE, contact_s=contact_s)
        assert pressed.decayed
        assert pressed.duration_s == pytest.approx(struck.duration_s + contact_s, abs=3 / RATE)
    silent = impact_sound([30_000.0], [5.0], RATE, contact_s=0.01)
    assert not silent.samples.any()
    assert silent.duration_s == pytest.approx(0.01 + MIN_S, abs=2 / RATE)


def test_a_hard_contact_is_bright_and_a_soft_one_dull():
    hard, soft = (impact_sound([200.0, 8000.0], [5.0, 5.0], RATE, contact_s=one) for one in (5e-5, 4e-3))

    def balance(sound):
        spectrum = np.abs(np.fft.rfft(sound.samples[2000:20_000] * np.hanning(18_000)))
        hz = np.fft.rfftfreq(18_000, 1 / RATE)
        return spectrum[hz > 4000].max() / spectrum[hz < 4000].max()

    assert balance(hard) > 100 * balance(soft)


@pytest.mark.parametrize("contact_s", [-1e-3, np.inf, np.nan])
def test_refuses_a_contact_that_is_none(contact_s):
    with pytest.raises(ValueError, match="the contact must last 0 s or longer"):
        impact_sound([100.0], [1.0], RATE, contact_s=contact_s)
