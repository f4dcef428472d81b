"""Which peaks of a sound are which modes of a body.

On a logarithmic axis the frequencies of a body of known shape form a comb that material and size only shift:
``log f = log s + log ω̂``. Peaks and modes are matched in their order. A mode may be missing (it hardly moves where the
body was struck, or it dies too soon) and a peak may be spurious (noise, a support, a second body). The score of a match
is its log-likelihood over that of no match at all, so shifts that put the peaks where modes are dense gain nothing by
it: the modes between the peaks are missing there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

#: Share of the modes in the range of the peaks that are not heard, and of the peaks that are no modes.
MISSING, SPURIOUS = 0.35, 0.2
#: Modes closer than this, in log frequency, are heard as one.
TOGETHER = 3e-3
#: Width in log frequency of the bins and the blur of the votes for shifts.
_BIN, _BLUR = 1e-3, 2.5
#: Shifts of each comb that are scored; cells of the tables of scores made at once.
_SHIFTS, _CELLS = 12, 4_000_000


@dataclass(frozen=True)
class Heard:
    """Peaks as the assignment sees them: ``log_frequency`` (n,), ascending, and its standard error (n,)."""

    log_frequency: np.ndarray
    error: np.ndarray

    @property
    def clutter(self) -> float:
        """Spurious peaks to be expected per unit of log frequency."""
        extent = max(np.ptp(self.log_frequency), 0.5)
        return SPURIOUS * len(self.log_frequency) / extent


@dataclass(frozen=True)
class Match:
    """Pairs of ``peaks`` and ``modes`` (n,), both ascending, with their score."""

    peaks: np.ndarray
    modes: np.ndarray
    score: float


def search(
    heard: Heard, combs: np.ndarray, error: np.ndarray, bounds: tuple[float, float], spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the best shifts of each comb: indices of combs (c,), shifts (c,) and scores (c,), best first.

    ``combs`` (r, m) hold ``log ω̂`` for each hypothesis, ``error`` (m,) their standard errors, ``bounds`` those of the
    shift. ``spread`` is the standard deviation of what peaks and combs differ by otherwise.
    """
    rows, shifts = [], []
    for row, comb in enumerate(combs):
        found = _votes(heard, comb, bounds)
        rows += [row] * len(found)
        shifts += list(found)
    rows, shifts = np.array(rows, dtype=int), np.array(shifts)
    scores = np.empty(len(rows))
    step = max(1, _CELLS // (combs.shape[1] * max(len(heard.error), 1)))
    for start in range(0, len(rows), step):
        part = slice(start, start + step)
        predicted = combs[rows[part]] + shifts[part, None]
        scores[part] = _table(heard, predicted, error, spread)[-1, :, -1] + _unheard(heard, predicted)
    order = np.argsort(-scores, kind="stable")
    return rows[order], shifts[order], scores[order]


def match(heard: Heard, predicted: np.ndarray, error: np.ndarray, spread: float) -> Match:
    """Return the best match of the peaks with predicted log frequencies (m,)."""
    table = _table(heard, predicted[None], error, spread)[:, 0]
    peaks, modes = [], []
    i, k = len(table) - 1, table.shape[1] - 1
    while i and k:
        if table[i, k] == table[i, k - 1]:
            k -= 1
        elif table[i, k] == table[i - 1, k]:
            i -= 1
        else:
            i, k = i - 1, k - 1
            peaks.append(i)
            modes.append(k)
    score = float(table[-1, -1] + _unheard(heard, predicted[None])[0])
    return Match(np.array(peaks[::-1], dtype=int), np.array(modes[::-1], dtype=int), score)


def ideal(heard: Heard, peaks: np.ndarray, error: np.ndarray, spread: float) -> float:
    """Return the score to be expected if some peaks (n,) are the only modes, each as far off as its errors say."""
    variance = heard.error[peaks] ** 2 + np.mean(error**2) + spread**2
    gain = np.log((1 - MISSING) / MISSING) - 0.5 * np.log(2 * np.pi * variance) - np.log(heard.clutter) - 0.5
    return float(gain.sum())


def _votes(heard: Heard, comb: np.ndarray, bounds: tuple[float, float]) -> np.ndarray:
    """Return the shifts within bounds at which most peaks lie on modes; a mode counts by its distance to others."""
    apart = np.gradient(comb) if len(comb) > 1 else np.ones(1)
    weight = np.minimum(apart / np.median(apart), 3.0)
    differences = heard.log_frequency[:, None] - comb
    count = max(int((bounds[1] - bounds[0]) / _BIN), 1)
    votes, edges = np.histogram(
        differences, bins=count, range=bounds, weights=np.broadcast_to(weight, differences.shape)
    )
    votes = gaussian_filter1d(votes, _BLUR, mode="constant")
    peaks = np.flatnonzero((votes >= np.roll(votes, 1)) & (votes > np.roll(votes, -1)))
    best = peaks[np.argsort(-votes[peaks], kind="stable")[:_SHIFTS]]
    return 0.5 * (edges[best] + edges[best + 1])


def _weights(predicted: np.ndarray) -> np.ndarray:
    """Return the share (c, m) of each mode in a mode that is heard: modes close together share one."""
    starts = np.diff(predicted, axis=1, prepend=-np.inf) > TOGETHER
    members = np.cumsum(starts, axis=1) - 1
    return np.stack([1.0 / np.bincount(row)[row] for row in members])


def _unheard(heard: Heard, predicted: np.ndarray) -> np.ndarray:
    """Return the log-likelihood (c,) that no mode in the range of the peaks is heard."""
    low, high = heard.log_frequency[0] - 1.0, heard.log_frequency[-1]
    within = (predicted >= low) & (predicted <= high)
    return np.log(MISSING) * (within * _weights(predicted)).sum(axis=1)


def _table(heard: Heard, predicted: np.ndarray, error: np.ndarray, spread: float) -> np.ndarray:
    """Return the scores (n + 1, c, m + 1) of the best matches among the first peaks and the first modes."""
    count = len(heard.error)
    table = np.zeros((count + 1, len(predicted), predicted.shape[1] + 1))
    low, high = heard.log_frequency[0] - 1.0, heard.log_frequency[-1]
    found = np.log(1 - MISSING) - np.log(MISSING) * (
        _weights(predicted) * ((predicted >= low) & (predicted <= high))
    )
    for i in range(count):
        variance = heard.error[i] ** 2 + error**2 + spread**2
        apart = heard.log_frequency[i] - predicted
        gain = found - 0.5 * apart**2 / variance - 0.5 * np.log(2 * np.pi * variance) - np.log(heard.clutter)
        matched = table[i, :, :-1] + gain
        best = np.maximum(table[i], np.concatenate([table[i, :, :1], matched], axis=1))
        np.maximum.accumulate(best, axis=1, out=table[i + 1])
    return table
