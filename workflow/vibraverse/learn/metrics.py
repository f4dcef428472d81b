"""Measures of how good predictions are, with intervals."""

from __future__ import annotations

import numpy as np

#: Modes that are looked at together: the first, the next seven, the rest.
MODE_GROUPS = {"1": slice(0, 1), "2-8": slice(1, 8), "9-64": slice(8, None)}
#: Relative errors below which the first eight frequencies of a body count as found.
WITHIN = (0.01, 0.03, 0.06)
#: Distances, as shares of a body's longest side, within which points of a reconstructed surface count as found.
NEAR = (0.01, 0.02)
#: A prediction counts as at least this much: its ratio to the truth has a logarithm.
LOWEST = 1e-3
_Z = 1.959963984540054


def frequency_errors(predicted: np.ndarray, true: np.ndarray) -> dict[str, float]:
    """Return measures of predicted frequencies (n, m) against the true ones (n, m), in Hz or dimensionless.

    Medians and 90th percentiles of the relative error over all modes and by group; the median deviation of mode 1 in
    cents; the shares of bodies whose first eight frequencies are all within 1, 3 and 6 %.
    """
    error = np.abs(predicted / true - 1.0)
    found = {"median": _percentile(error, 50), "p90": _percentile(error, 90)}
    for name, modes in MODE_GROUPS.items():
        if error[:, modes].size:
            found[f"median_modes_{name}"] = _percentile(error[:, modes], 50)
            found[f"p90_modes_{name}"] = _percentile(error[:, modes], 90)
    found["cents_mode_1"] = _percentile(np.abs(1200.0 * np.log2(predicted[:, 0] / true[:, 0])), 50)
    for bound in WITHIN:
        found[f"first_8_within_{bound:.0%}"] = float((error[:, :8].max(axis=1) <= bound).mean())
    return found


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson's score."""
    if count == 0:
        return 0.0, 1.0
    share, z2 = hits / count, _Z**2
    centre = (share + z2 / (2 * count)) / (1 + z2 / count)
    half = _Z * np.sqrt(share * (1 - share) / count + z2 / (4 * count**2)) / (1 + z2 / count)
    return float(centre - half), float(centre + half)


def mcnemar(one: np.ndarray, other: np.ndarray) -> float:
    """Return the probability that two equally good classifiers differ as much on the same samples (n,) as these.

    ``one`` and ``other`` are True where each is right. Exact: a binomial test of the samples on which they differ.
    """
    from scipy.stats import binomtest

    wins, losses = int((one & ~other).sum()), int((other & ~one).sum())
    return float(binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0


def bootstrap(values: np.ndarray, groups: np.ndarray, statistic=np.median, draws: int = 1000, seed: int = 0):
    """Return the 95 % interval of a statistic of values (n, …) over resampled groups (n,), such as objects."""
    random = np.random.default_rng(seed)
    names, inverse = np.unique(groups, return_inverse=True)
    members = [np.flatnonzero(inverse == number) for number in range(len(names))]
    found = []
    for _ in range(draws):
        drawn = random.integers(len(names), size=len(names))
        found.append(statistic(values[np.concatenate([members[number] for number in drawn])]))
    return tuple(float(bound) for bound in np.percentile(found, [2.5, 97.5]))


def _percentile(values: np.ndarray, which: float) -> float:
    return float(np.percentile(values, which))
