"""What the peaks of a sound say about a body of known shape, and whether they say it.

An answer stands if its match is better than any that chance would find. Chance is tried: the modes of the body are
moved at random by some per cent, and the search is made again. The body's own modes must do better by far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.contract.errors import UsageError
from vibraverse.contract.seeds import rng
from vibraverse.listening import assignment
from vibraverse.listening.assignment import Heard
from vibraverse.listening.decay import Damping, damping
from vibraverse.listening.fit import SEARCH_SPREAD, Estimate, Model, Searchable, fit, polished
from vibraverse.listening.peaks import Peaks
from vibraverse.listening.resonances import Lines

#: Fewest peaks that say anything.
MIN_PEAKS = 3
#: Random bodies, and the standard deviation in log frequency by which their modes are moved.
_DECOYS, _MOVED = 12, 0.05
#: Starts that are refined for each of them.
_DECOY_STARTS = 4
#: A match must be this many standard deviations above the mean of the random bodies; 1 % of maxima (Gumbel) are.
_ABOVE_CHANCE = 3.0
#: Smallest share of the peaks among the modes that must be explained, the smallest share of the score that a match of
#: all of them would have, and the largest spread in log frequency.
_MIN_EXPLAINED, _MIN_SCORE, _MAX_SPREAD = 0.5, 0.33, 0.02
#: Another answer is as good if its score is less than this below the best one, a likelihood ratio of 20.
_AS_GOOD = 3.0


@dataclass(frozen=True)
class Answer:
    """The best ``estimate`` and ``others`` that are as good, with the damping of its modes.

    ``score`` is compared with ``chance``, mean and standard deviation of the scores of random bodies, and with
    ``ideal``, that of a match of all peaks without a missing mode. ``explained`` of ``within`` peaks in the range of
    the body's modes are matched.
    """

    estimate: Estimate
    others: list[Estimate]
    damping: Damping | None
    score: float
    chance: tuple[float, float]
    ideal: float
    explained: int
    within: int

    @property
    def explains(self) -> bool:
        """Whether most peaks lie near modes."""
        enough = self.explained >= _MIN_EXPLAINED * self.within and self.score > _MIN_SCORE * self.ideal
        return enough and self.estimate.spread < _MAX_SPREAD

    @property
    def above_chance(self) -> bool:
        """Whether they do so better than near the modes of random bodies."""
        return self.score > self.chance[0] + _ABOVE_CHANCE * self.chance[1]

    @property
    def fits(self) -> bool:
        """Whether the body made the sound, as far as it tells."""
        return self.explains and self.above_chance


def answer(peaks: Peaks, model: Searchable, bounds: np.ndarray, exact: Model | None = None) -> Answer:
    """Return what peaks say about a body with the lines of ``model``.

    ``bounds`` (1 + q, 2) are those of ``log s`` and the model's parameters, as for
    :func:`vibraverse.listening.fit.fit`. ``exact`` refines what a table found. Raises :class:`UsageError` for too few
    peaks.
    """
    enough(peaks)
    heard = Heard(np.log(peaks.frequency_hz), peaks.frequency_error_hz / peaks.frequency_hz)
    found = fit(heard, model, bounds)
    if not found:
        raise UsageError(
            f"no three of the {len(peaks)} peaks match modes of the body; check the mesh, its size and the recording"
        )
    best = found[0]
    others = [one for one in found[1:] if one.match.score > best.match.score - _AS_GOOD]
    if exact is not None:
        best = polished(heard, exact, bounds, best)
    lines = (exact or model).at(best.values[1:])
    predicted = best.values[0] + lines.log_omega
    reach = heard.log_frequency < predicted[-1] + 0.01
    within, explained = int(reach.sum()), len(best.match.peaks)
    matched = peaks.chosen(best.match.peaks)
    known = np.isfinite(matched.decay_error_per_s)
    decays = None
    if known.sum() > 2:
        decays = damping(
            matched.frequency_hz[known], matched.decay_per_s[known], matched.decay_error_per_s[known]
        )
    ideal = assignment.ideal(heard, np.flatnonzero(reach), lines.error, SEARCH_SPREAD)
    chance = _by_chance(heard, model, bounds)
    return Answer(best, others, decays, found[0].match.score, chance, ideal, explained, within)


def enough(peaks: Peaks) -> None:
    """Raise :class:`UsageError` if there are too few peaks to say anything."""
    if len(peaks) < MIN_PEAKS:
        raise UsageError(
            f"{len(peaks)} {'peak' if len(peaks) == 1 else 'peaks'} can be heard, at least {MIN_PEAKS} are "
            "needed; record nearer, in a quieter place, and let the body ring freely"
        )


class _Moved:
    """A body whose lines are moved by ``off`` (m,)."""

    def __init__(self, model: Searchable, off: np.ndarray):
        self._model, self._off, self.bounds = model, off, model.bounds

    def at(self, parameters: np.ndarray) -> Lines:
        lines = self._model.at(parameters)
        order = np.argsort(lines.log_omega + self._off, kind="stable")
        return Lines((lines.log_omega + self._off)[order], lines.slopes[order], lines.error[order])

    def grid(self, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        parameters, combs = self._model.grid(bounds)
        return parameters, np.sort(combs + self._off, axis=1)


def _by_chance(heard: Heard, model: Searchable, bounds: np.ndarray) -> tuple[float, float]:
    """Return the mean and the standard deviation of the scores of random bodies."""
    random, scores = rng("listening", "chance"), []
    modes = len(model.at(model.bounds.mean(axis=1)).log_omega)
    for _ in range(_DECOYS):
        found = fit(heard, _Moved(model, _MOVED * random.standard_normal(modes)), bounds, _DECOY_STARTS)
        scores.append(found[0].match.score if found else 0.0)
    return float(np.mean(scores)), float(np.std(scores, ddof=1))
