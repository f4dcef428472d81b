"""Rayleigh damping ``D = αM + βK``: decay rates ``d = ½(α + β ω²)``, damped frequencies ``ω_d = sqrt(ω² - d²)``."""

from __future__ import annotations

import numpy as np


def rayleigh_damping(omega: np.ndarray, alpha, beta) -> tuple[np.ndarray, np.ndarray]:
    """Return ``d`` in 1/s and ``ω_d`` in rad/s (0 where overdamped) for angular frequencies in rad/s."""
    damping = 0.5 * (alpha + beta * omega**2)
    return damping, np.sqrt(np.maximum(omega**2 - damping**2, 0.0))
