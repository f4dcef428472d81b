"""Rayleigh damping from decay rates: ``d = ½(α + β ω²)``, by weighted least squares with α and β not negative.

Decay rates scatter more than their errors say, because supports, air and merged pairs of modes add to them. The
scatter is a share of each rate, such that the weighted squares sum to the degrees of freedom. Rates far off count less
(Huber, Ann. Math. Stat. 35, 73, 1964).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.stats import t as student

#: Residuals above this many standard deviations count less, and rounds of reweighting.
_HUBER, _ROUNDS = 2.0, 25
#: Largest scatter of decay rates, as a share.
_MAX_SCATTER = 2.0


@dataclass(frozen=True)
class Damping:
    """α in 1/s and β in s with their covariance (2, 2), and the scatter of decay rates as a share of them."""

    alpha_per_s: float
    beta_s: float
    covariance: np.ndarray
    freedom: int
    scatter: float

    def half_widths(self, share: float = 0.95) -> tuple[float, float]:
        """Return half the widths of the intervals that hold α and β with a probability."""
        factor = float(student.ppf(0.5 + share / 2, max(self.freedom, 1)))
        alpha, beta = factor * np.sqrt(np.diag(self.covariance))
        return float(alpha), float(beta)


def damping(frequency_hz: np.ndarray, decay_per_s: np.ndarray, error_per_s: np.ndarray) -> Damping:
    """Return the damping of modes with undamped frequencies (n,), decay rates (n,) and their errors (n,); n >= 2."""
    omega = 2 * np.pi * frequency_hz
    # Columns of one size keep the problem well conditioned.
    size = np.square(omega).mean()
    columns = 0.5 * np.column_stack([np.ones_like(omega), omega**2 / size])
    huber, scatter = np.ones_like(omega), 0.0
    found = nnls(columns / error_per_s[:, None], decay_per_s / error_per_s)[0]
    for _ in range(_ROUNDS):
        expected = columns @ found
        residual = decay_per_s - expected
        scatter = _scatter(residual, expected, error_per_s, huber)
        deviation = np.hypot(error_per_s, scatter * expected)
        huber = np.minimum(1.0, _HUBER * deviation / np.maximum(np.abs(residual), 1e-300))
        root = np.sqrt(huber) / deviation
        before, found = found, nnls(columns * root[:, None], decay_per_s * root)[0]
        if np.abs(found - before).max() <= 1e-9 * np.abs(found).max():
            break
    covariance = np.linalg.pinv((columns * root[:, None]).T @ (columns * root[:, None]), hermitian=True)
    unit = np.array([1.0, 1.0 / size])
    alpha, beta = (float(one) for one in found * unit)
    return Damping(alpha, beta, covariance * np.outer(unit, unit), len(omega) - 2, float(scatter))


def _scatter(residual: np.ndarray, expected: np.ndarray, error: np.ndarray, weight: np.ndarray) -> float:
    """Return the share of the expected rates whose square, added to that of the errors, explains the residuals."""
    freedom = max(weight.sum() - 2, 1e-9)

    def squares(share: float) -> float:
        return float((weight * residual**2 / (error**2 + (share * expected) ** 2)).sum())

    low, high = 0.0, _MAX_SCATTER
    if squares(low) <= freedom:
        return 0.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if squares(middle) > freedom else (low, middle)
    return high
