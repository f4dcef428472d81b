"""Open-ended families with soft seams: smooth blends of simple bodies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from vibraverse.sources.families.fields import KINDS, Field, ball, level_set, placed, soft_cut, soft_union
from vibraverse.sources.families.primitives import direction, rotation
from vibraverse.sources.families.redraw import OpenShape
from vibraverse.sources.families.shape import between

#: Cells of the grid along the longest side.
CELLS = 40
#: A part reaches at most this many times its size from its centre.
_REACH = 1.9


@dataclass(frozen=True)
class Blend(OpenShape):
    """A soft union of simple bodies, with soft cuts."""

    size_range_m = (0.05, 0.4)
    ridge_deg = 50.0
    parts: int = between(3, 9)
    cuts: float = between(0.0, 0.4)
    blend: float = between(0.05, 0.3)
    stretch: float = between(0.4, 1.0)

    def body(self, random: np.random.Generator) -> Manifold | None:
        """Take the level set of the blended distances, stretched along z."""
        field, low, high = blended(random, self.parts, self.cuts, self.blend)
        return level_set(field, low, high, CELLS).scale([1.0, 1.0, self.stretch])


def blended(
    random: np.random.Generator, parts: int, cuts: float, blend: float
) -> tuple[Field, np.ndarray, np.ndarray]:
    """Draw a blend and return its field and a box that holds it; its first part has size 0.5.

    Each further part grows out of one before it, or is cut from one with the chance ``cuts``.
    """
    centres, sizes = [np.zeros(3)], [0.5]
    chain = [(_part(random, centres[0], sizes[0]), False)]
    for _ in range(parts - 1):
        parent = int(random.integers(len(centres)))
        away, size = direction(random), random.uniform(0.45, 0.9) * sizes[parent]
        if random.random() < cuts:
            size = 0.7 * size
            centre = centres[parent] + 0.8 * sizes[parent] * away
            chain.append((_part(random, centre, size), True))
            continue
        centres.append(centres[parent] + 0.75 * (sizes[parent] + size) * away)
        sizes.append(size)
        chain.append((_part(random, centres[-1], size), False))
    reach = _REACH * np.array(sizes)[:, None] + blend

    def field(points: np.ndarray) -> np.ndarray:
        values = chain[0][0](points)
        for part, cut in chain[1:]:
            values = (soft_cut if cut else soft_union)(values, part(points), blend)
        return values

    return field, (np.array(centres) - reach).min(axis=0), (np.array(centres) + reach).max(axis=0)


def _part(random: np.random.Generator, centre: np.ndarray, size: float) -> Field:
    kind = KINDS[random.integers(len(KINDS))]
    sides = size * (np.ones(3) if kind is ball else random.uniform(0.4, 1.0, size=3))
    return placed(kind(sides), rotation(random), centre)
