"""Measures of retrieval: where the right entries of a pool stand in the order of a query's scores.

Entries of equal score stand in random order, so each measure is its expectation over all such orders: an embedding
that is the same for all scores as chance does, exactly (McSherry and Najork 2008 for the average precision).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

#: A query succeeds if a right entry is among so many first ones.
CUTOFFS = (1, 5, 10)
#: Measures of one query: success at the cutoffs, reciprocal rank and rank of the first right entry, average precision.
RANK, PRECISION = "rank", "map"
#: Resamplings of the objects for an interval.
DRAWS = 1000
#: Scores that are compared with each other at once.
_AT_ONCE = 4_000_000


def measures(queries: np.ndarray, entries: np.ndarray, right: np.ndarray) -> dict[str, np.ndarray]:
    """Return the measures (q,) of queries (q, d) in a pool of entries (n, d); a score is an inner product.

    ``right`` (q, n) is True for the right entries; each query has one at least.
    """
    share = max(1, _AT_ONCE // len(entries))
    parts = [
        of_scores(queries[first : first + share] @ entries.T, right[first : first + share])
        for first in range(0, len(queries), share)
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def of_scores(scores: np.ndarray, right: np.ndarray) -> dict[str, np.ndarray]:
    """Return the measures (q,) of scores (q, n), see :func:`measures`; what is not a number is the lowest."""
    scores = np.nan_to_num(scores, nan=-np.inf, posinf=np.inf, neginf=-np.inf)
    best = np.where(right, scores, -np.inf).max(axis=1, keepdims=True)
    above, level = (scores > best).sum(axis=1), scores == best
    tied, good = level.sum(axis=1), (level & right).sum(axis=1)
    # The share of orders in which no right entry is among the first j tied ones, for all j.
    later = _all_later(np.arange(tied.max() + 1)[None], tied[:, None], good[:, None])
    places = above[:, None] + np.arange(1, later.shape[1])
    found = {
        f"top_{cutoff}": 1.0 - _all_later(np.clip(cutoff - above, 0, tied), tied, good) for cutoff in CUTOFFS
    }
    found["mrr"] = ((later[:, :-1] - later[:, 1:]) / places).sum(axis=1)
    found[RANK] = above + (tied + 1) / (good + 1)
    found[PRECISION] = _average_precision(scores, right)
    return found


def _all_later(first: np.ndarray, tied: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Return the probability that ``good`` of ``tied`` entries in random order all stand behind the ``first`` ones."""
    share = np.ones(np.broadcast_shapes(first.shape, tied.shape))
    for number in range(good.max()):
        factor = np.maximum(tied - first - number, 0) / np.maximum(tied - number, 1)
        share = share * np.where(number < good, factor, 1.0)
    return share


def _average_precision(scores: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the mean over right entries (q,) of the share of right ones among all up to each, expected over ties."""
    total = np.zeros(len(scores))
    harmonic = np.concatenate([[0.0], np.cumsum(1.0 / np.arange(1, scores.shape[1] + 1))])
    # The k-th right entry of every query that has one, for all queries at once.
    turn = np.where(right, np.cumsum(right, axis=1), 0)
    for number in range(1, turn.max() + 1):
        rows, columns = np.nonzero(turn == number)
        some, own = scores[rows], scores[rows, columns][:, None]
        before, level = some > own, some == own
        above, tied = before.sum(axis=1), level.sum(axis=1)
        right_before, good = (before & right[rows]).sum(axis=1), (level & right[rows]).sum(axis=1)
        inverse = harmonic[above + tied] - harmonic[above]
        others = np.where(tied > 1, (good - 1) / np.maximum(tied - 1, 1), 0.0)
        total[rows] += ((right_before + 1) * inverse + others * (tied - (above + 1) * inverse)) / tied
    return total / right.sum(axis=1)


def summary(found: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Return the means of measures over queries (q,); of the rank, the median."""
    return {
        "median_rank" if name == RANK else name: float(np.median(values) if name == RANK else values.mean())
        for name, values in found.items()
    }


def resampled(found: Mapping[str, np.ndarray], objects: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
    """Return :func:`summary` over resampled objects: for each measure :data:`DRAWS` values.

    ``objects`` (q,) names the object of each query; all queries of an object come and go together. The pool stays.
    Calls with the same set of objects draw the same ones.
    """
    names, member = np.unique(objects, return_inverse=True)
    count = np.bincount(member)
    drawn = np.random.default_rng(seed).multinomial(len(names), np.full(len(names), 1 / len(names)), DRAWS)
    results = {}
    for name, values in found.items():
        if name == RANK:
            results["median_rank"] = _medians(values, member, drawn)
        else:
            results[name] = drawn @ np.bincount(member, values) / (drawn @ count)
    return results


def _medians(values: np.ndarray, member: np.ndarray, drawn: np.ndarray) -> np.ndarray:
    """Return the medians of values (q,), each counted as often as its object in a row of ``drawn`` (draws, objects)."""
    order = np.argsort(values)
    ordered, member = values[order], member[order]
    found = []
    for weights in drawn:
        upto = np.cumsum(weights[member])
        found.append(ordered[np.searchsorted(upto, upto[-1] / 2)])
    return np.array(found)
