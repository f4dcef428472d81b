"""State of one rung of the repair ladder, and the cache that rungs share."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from vibraverse.geometry import Mesh
from vibraverse.geometry.cleaning.judge import Unfit


@dataclass
class Attempt:
    """What one rung may do, and what it did."""

    max_dropped: float = 0.0
    """Share of the volume that dropping rungs may drop."""
    max_joined: float = 0.0
    """Share of the volume by which a wrap that joins separate bodies may change it."""
    thickness: float = 0.0
    """Thickness that thickening rungs give to sheets, in normalised units."""
    cache: dict[tuple, tuple[Attempt, list[Mesh] | Unfit]] = field(default_factory=dict)
    """Results of shared steps, by step and options."""
    notes: list[str] = field(default_factory=list)
    """Descriptions of the changes."""
    dropped: list[Mesh] = field(default_factory=list)
    """Bodies that were dropped."""
    dropped_share: float = 0.0
    """Their share of the volume."""
    joined: int = 0
    """Number of separate bodies that a wrap joined; 0 if it joined none."""
    joined_growth: float = 0.0
    """Relative change of their volume."""
    filled_cavities: int = 0
    """Number of inner shells, facing inwards, that were filled."""


def cached(step: Callable) -> Callable:
    """Cache a step that several rungs share: later rungs get its result, notes included."""

    @functools.wraps(step)
    def taken(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt, *options: float) -> list[Mesh]:
        key = step, *options
        if key not in attempt.cache:
            own = Attempt(cache=attempt.cache)
            try:
                attempt.cache[key] = own, step(vertices, faces, own, *options)
            except Unfit as unfit:
                attempt.cache[key] = own, unfit
        own, result = attempt.cache[key]
        if isinstance(result, Unfit):
            raise result
        attempt.notes += own.notes
        attempt.filled_cavities += own.filled_cavities
        return result

    return taken
