"""The material of a body of known shape from the peaks of its sound: ``log s`` and Poisson's ratio, by least squares.

Several starts come from the search of :mod:`vibraverse.listening.assignment`. From each, matching and weighted least
squares take turns. What the residuals have beyond the errors of peaks and elements is their *spread*: errors of the
shape, of the supports, of the assumption of one isotropic material. It is the likeliest one (restricted maximum
likelihood: Harville, J. Am. Stat. Assoc. 72, 320, 1977).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student

from vibraverse.listening import assignment
from vibraverse.listening.assignment import TOGETHER, Heard, Match
from vibraverse.listening.resonances import Lines

#: Spread in log frequency that the search assumes, and those that matching then tries, one after the other.
SEARCH_SPREAD, _SPREADS = 5e-3, (5e-3, 2.5e-3, 1.2e-3)
#: Starts of the search that are refined, and the difference of values below which two results are one.
_STARTS, _SAME = 10, 1e-2
#: Range of the spread. No real body is nearer to its mesh than the lowest.
_SPREAD_RANGE = (5e-4, 0.1)
#: Steps of least squares between two matchings, and the change of a parameter at which they end.
_STEPS, _SMALL_STEP = 10, 1e-6
#: Share of the elements' error that all modes have in common: corrected frequencies are still upper bounds.
_COMMON = 0.5


class Model(Protocol):
    """Predicts lines from parameters (q,) within ``bounds`` (q, 2)."""

    bounds: np.ndarray

    def at(self, parameters: np.ndarray) -> Lines:
        """Return the lines at some parameters."""


class Searchable(Model, Protocol):
    """A model that also lists hypotheses."""

    def grid(self, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return hypotheses about the parameters (r, q) within bounds (q, 2), and their ``log ω̂`` (r, m)."""


@dataclass(frozen=True)
class Estimate:
    """Values (1 + q,) of ``log s`` and the model's parameters, with covariance (1 + q, 1 + q).

    ``match`` pairs peaks and modes, ``residual`` (n,) are their differences in log frequency, ``spread`` is as above.
    ``free`` (1 + q,) says what was sought, ``at_bound`` (1 + q,) what ended at a bound. The known has no variance.
    """

    values: np.ndarray
    covariance: np.ndarray
    match: Match
    residual: np.ndarray
    spread: float
    free: np.ndarray
    at_bound: np.ndarray

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals."""
        return len(self.residual) - int(self.free.sum())

    def half_width(self, which: int, share: float = 0.95) -> float:
        """Return half the width of the interval that holds a value with a probability."""
        return float(
            student.ppf(0.5 + share / 2, max(self.freedom, 1)) * np.sqrt(self.covariance[which, which])
        )


def fit(heard: Heard, model: Searchable, bounds: np.ndarray, starts: int = _STARTS) -> list[Estimate]:
    """Return the different estimates that the peaks allow, best first by the score of their match.

    ``bounds`` (1 + q, 2) are those of ``log s`` and the parameters; where both ends are equal, the value is known.
    ``starts`` of the search are refined.
    """
    parameters, combs = model.grid(bounds[1:])
    error = model.at(parameters[len(parameters) // 2]).error
    margin = 2 * SEARCH_SPREAD
    rows, shifts, _ = assignment.search(
        heard, combs, error, (bounds[0, 0] - margin, bounds[0, 1] + margin), SEARCH_SPREAD
    )
    found: list[Estimate] = []
    for row, shift in _apart(rows, shifts, parameters, starts):
        start = np.clip(np.concatenate([[shift], parameters[row]]), *bounds.T)
        found += _refined(heard, model, start, bounds)
    return _different(sorted(found, key=lambda one: -one.match.score))


def polished(heard: Heard, model: Model, bounds: np.ndarray, estimate: Estimate) -> Estimate:
    """Return an estimate from a table after least squares with the lines themselves."""
    better = _least_squares(heard, model, estimate.values, bounds, estimate.match)
    return estimate if better is None else better


def _different(estimates: list[Estimate]) -> list[Estimate]:
    """Return the estimates that differ in their values from all better ones."""
    kept: list[Estimate] = []
    for one in estimates:
        if not any(np.abs(one.values - other.values).max() < _SAME for other in kept):
            kept.append(one)
    return kept


def _apart(
    rows: np.ndarray, shifts: np.ndarray, parameters: np.ndarray, most: int
) -> list[tuple[int, float]]:
    """Return the first starts that are not neighbours of better ones."""
    kept: list[tuple[int, float]] = []
    for row, shift in zip(rows, shifts, strict=True):
        near = any(
            abs(shift - other) < 0.02 and np.abs(parameters[row] - parameters[at]).max() < 0.06
            for at, other in kept
        )
        if not near:
            kept.append((row, shift))
        if len(kept) == most:
            break
    return kept


def _refined(heard: Heard, model: Model, start: np.ndarray, bounds: np.ndarray) -> list[Estimate]:
    """Return the best estimate by matching and least squares in turns, in a list; empty if too few peaks match."""
    values, best = start, []
    for spread in _SPREADS:
        for _ in range(2):
            lines = model.at(values[1:])
            match = assignment.match(heard, values[0] + lines.log_omega, lines.error, spread)
            estimate = _least_squares(heard, model, values, bounds, match)
            if estimate is None:
                return best
            values = estimate.values
        lines = model.at(values[1:])
        match = assignment.match(heard, values[0] + lines.log_omega, lines.error, spread)
        if not best or match.score > best[0].match.score:
            estimate = _least_squares(heard, model, values, bounds, match)
            best = [estimate] if estimate is not None else best
    return best


def _least_squares(
    heard: Heard, model: Model, values: np.ndarray, bounds: np.ndarray, match: Match
) -> Estimate | None:
    """Return the least-squares estimate of a match; None if it has fewer pairs than there are unknowns."""
    free = bounds[:, 1] > bounds[:, 0]
    if len(match.peaks) < max(free.sum(), 1):
        return None
    heard_at, errors = heard.log_frequency[match.peaks], heard.error[match.peaks]
    spread, covariance = 0.0, None
    for _ in range(_STEPS):
        at, slopes, element = _paired(model.at(values[1:]), match)
        residual = heard_at - values[0] - at
        own = errors**2 + (1 - _COMMON) * element**2
        jacobian = np.hstack([np.ones((len(at), 1)), slopes])[:, free]
        spread = _spread(residual, jacobian, own)
        inverse = np.linalg.inv(np.diag(own + spread**2) + _COMMON * np.outer(element, element))
        step = np.zeros(len(values))
        moving = free.copy()
        while moving.any():
            part = np.hstack([np.ones((len(at), 1)), slopes])[:, moving]
            step[:] = 0.0
            step[moving] = np.linalg.pinv(part.T @ inverse @ part, hermitian=True) @ (
                part.T @ inverse @ residual
            )
            beyond = moving & ((values + step < bounds[:, 0]) | (values + step > bounds[:, 1]))
            outward = np.clip(values + step, *bounds.T) - values
            if not beyond.any():
                break
            # What meets its bound stays there while the others are solved for again.
            values = np.where(beyond, values + outward, values)
            residual = heard_at - values[0] - at - slopes @ (outward * beyond)[1:]
            moving &= ~beyond
        values = values + np.where(moving, step, 0.0)
        covariance = np.zeros((len(values),) * 2)
        covariance[np.ix_(free, free)] = np.linalg.pinv(jacobian.T @ inverse @ jacobian, hermitian=True)
        if np.abs(step).max() < _SMALL_STEP:
            break
    at, _, _ = _paired(model.at(values[1:]), match)
    at_bound = free & ((values <= bounds[:, 0] + 1e-9) | (values >= bounds[:, 1] - 1e-9))
    return Estimate(values, covariance, match, heard_at - values[0] - at, spread, free, at_bound)


def _paired(lines: Lines, match: Match) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ``log ω̂`` (n,), slopes (n, q) and errors (n,) of the matched modes.

    A peak stands for all modes beside its own that are too close to be heard apart and have no peak of their own.
    """
    taken = np.zeros(len(lines.log_omega), dtype=bool)
    taken[match.modes] = True
    at, slopes, error = (one[match.modes].copy() for one in (lines.log_omega, lines.slopes, lines.error))
    for i, mode in enumerate(match.modes):
        near = np.abs(lines.log_omega - lines.log_omega[mode]) < TOGETHER
        near &= ~taken
        near[mode] = True
        if near.sum() > 1:
            at[i], slopes[i] = lines.log_omega[near].mean(), lines.slopes[near].mean(axis=0)
            error[i] = np.hypot(error[i], np.ptp(lines.log_omega[near]) / np.sqrt(12))
    return at, slopes, error


def _spread(residual: np.ndarray, jacobian: np.ndarray, variance: np.ndarray) -> float:
    """Return the likeliest spread of residuals (n,) beyond their ``variance`` (n,): restricted maximum likelihood."""
    if len(residual) <= jacobian.shape[1]:
        return 0.0

    def unlikely(log_spread: float) -> float:
        total = variance + np.exp(2 * log_spread)
        weighted = jacobian / total[:, None]
        normal = jacobian.T @ weighted
        moved = np.linalg.lstsq(normal, weighted.T @ residual, rcond=1e-12)[0]
        rest = residual - jacobian @ moved
        # The last term makes up for the parameters that the residuals have been fitted with.
        return float(np.log(total).sum() + (rest**2 / total).sum() + np.linalg.slogdet(normal)[1])

    low, high = _SPREAD_RANGE
    best = minimize_scalar(
        unlikely, bounds=(np.log(low), np.log(high)), method="bounded", options={"xatol": 0.02}
    )
    return float(np.exp(best.x)) if best.fun < unlikely(np.log(low)) else low
