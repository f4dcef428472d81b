"""What one rung of the ladder of repairs may do and did, and what it shares with the rungs after it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from vibraverse.geometry import Mesh
from vibraverse.geometry.cleaning.judge import Unfit


@dataclass
class Attempt:
    """What one rung may do and what it did."""

    max_dropped: float = 0.0
    """Share of the volume that may be dropped by the rungs that drop."""
    thickness: float = 0.0
    """Thickness given to sheets by the rungs that do, in normalised units."""
    made: dict[tuple, tuple[Attempt, list[Mesh] | Unfit]] = field(default_factory=dict)
    """What several rungs need, kept for those that come later."""
    notes: list[str] = field(default_factory=list)
    """What was done, in words."""
    dropped: list[Mesh] = field(default_factory=list)
    """Bodies left out."""
    dropped_share: float = 0.0
    """Their share of the volume."""
    filled_cavities: int = 0
    """Shells inside others, facing inwards, that were filled."""


def once(step: Callable) -> Callable:
    """Let a step of several rungs be taken by the first that needs it; later ones get the same, notes and all."""

    @functools.wraps(step)
    def taken(vertices: np.ndarray, faces: np.ndarray, attempt: Attempt, *options: float) -> list[Mesh]:
        key = step, *options
        if key not in attempt.made:
            own = Attempt(made=attempt.made)
            try:
                attempt.made[key] = own, step(vertices, faces, own, *options)
            except Unfit as unfit:
                attempt.made[key] = own, unfit
        own, result = attempt.made[key]
        if isinstance(result, Unfit):
            raise result
        attempt.notes += own.notes
        attempt.filled_cavities += own.filled_cavities
        return result

    return taken
