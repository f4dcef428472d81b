"""The motion of a mode while a half-sine force presses on it, and after, in closed form.

The force of a contact that lasts ``T`` is ``F(t) = (p/2) sin(p t)`` with ``p = π/T``; its impulse is 1. A mode with
angular frequency ``ω`` and damping ``d`` answers ``q'' + 2 d q' + ω² q = F``, at rest before.

With ``s = -d + i ω_d``, ``ω_d = sqrt(ω² - d²)`` and ``φ(z) = (e^z - 1) / z`` the motion of a ringing mode is

    q(t)     = p/(2 ω_d) Im G(t)           G(t) = t/(2i) [e^{ipt} φ((s - ip) t) - e^{-ipt} φ((s + ip) t)],   0 ≤ t ≤ T
    q(T + t) = Im(c e^{st})                c    = -(π p / (2 ω_d)) φ((s - ip) T) / (s + ip)

This is ``Im[(p e^{st} - s sin pt - p cos pt) / (s² + p²)]`` without its quotient 0/0 at resonance, ``s = ip``. No
exponential grows. A mode that is critically damped or more is the forced motion less its start,

    q(t) = (p/2) [A (sin pt - p h(t)) + B (cos pt - h'(t) - 2 d h(t))]
    A = (ω² - p²) / N,   B = -2 d p / N,   N = (ω² - p²)² + 4 d² p²

where ``h`` is the response to an impulse. Its denominator vanishes nowhere, since ``d`` is large.
"""

from __future__ import annotations

import numpy as np
from scipy.special import exprel

#: Modes with more damping than this share of ``ω`` take the second form, because the first divides by ``ω_d``.
_MAX_SHARE = 0.9


def impulse_motion(omega, damping, time_s) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement ``h`` and the velocity ``h'`` of modes after a unit impulse; arguments broadcast.

    ``h = e^{-d t} sin(ω_d t) / ω_d``, or ``e^{-d t} sinh(γ t) / γ`` with ``γ = sqrt(d² - ω²)`` for ``d ≥ ω``. The
    latter is evaluated as ``t e^{-(d-γ) t} exprel(-2 γ t)`` with ``d - γ = ω² / (d + γ)``, which neither overflows nor
    cancels.
    """
    root = np.sqrt(np.abs((damping - omega) * (damping + omega)))
    slow = omega**2 / (damping + root)
    creep = time_s * np.exp(-slow * time_s) * exprel(-2.0 * root * time_s)
    creeping = np.exp(-(damping + root) * time_s) - slow * creep
    decay = np.exp(-damping * time_s)
    rings = np.broadcast_to(damping < omega, decay.shape)
    ring = decay * np.sin(root * time_s) / np.where(root > 0, root, 1.0)
    return np.where(rings, ring, creep), np.where(
        rings, decay * np.cos(root * time_s) - damping * ring, creeping
    )


def contact_motion(omega, damping, contact_s: float, time_s) -> np.ndarray:
    """Return displacement, velocity and acceleration (3, m, n) of modes (m,) at times (n,) within the contact.

    They answer a force of unit impulse, which lasts ``contact_s`` seconds, above 0. Times are from 0 to ``contact_s``.
    """
    omega, damping = omega[:, None], damping[:, None]
    rings = damping[:, 0] < _MAX_SHARE * omega[:, 0]
    found = np.empty((3, len(omega), len(time_s)))
    push = np.pi / contact_s
    found[:, rings] = _ringing(omega[rings], damping[rings], push, time_s)
    found[:, ~rings] = _creeping(omega[~rings], damping[~rings], push, time_s)
    return found


def _ringing(omega, damping, push: float, time_s) -> np.ndarray:
    """Return the motion of modes (m, 1) with less damping; ``push`` is ``p``."""
    ringing = np.sqrt((omega - damping) * (omega + damping))
    s = -damping + 1j * ringing
    turn = np.exp(1j * push * time_s)
    g = time_s / 2j * (turn * _phi((s - 1j * push) * time_s) - turn.conj() * _phi((s + 1j * push) * time_s))
    first = s * g + turn.imag
    second = s * first + push * turn.real
    return push / (2.0 * ringing) * np.stack([g.imag, first.imag, second.imag])


def _phi(z: np.ndarray) -> np.ndarray:
    """Return ``(e^z - 1) / z``, 1 at 0."""
    return np.where(z == 0, 1.0, np.expm1(z) / np.where(z == 0, 1.0, z))


def _creeping(omega, damping, push: float, time_s) -> np.ndarray:
    """Return the motion of modes (m, 1) with more damping; ``push`` is ``p``."""
    h, velocity = impulse_motion(omega, damping, time_s)
    acceleration = -2.0 * damping * velocity - omega**2 * h
    stiff = omega**2 - push**2
    scale = stiff**2 + 4.0 * damping**2 * push**2
    a, b = stiff / scale, -2.0 * damping * push / scale
    sine, cosine = np.sin(push * time_s), np.cos(push * time_s)
    return (push / 2.0) * np.stack(
        [
            a * (sine - push * h) + b * (cosine - velocity - 2.0 * damping * h),
            a * push * (cosine - velocity) + b * (omega**2 * h - push * sine),
            -a * push * (push * sine + acceleration) + b * (omega**2 * velocity - push**2 * cosine),
        ]
    )
