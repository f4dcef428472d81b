"""Open-ended families made by set operations: trees of solids, and bodies full of holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from vibraverse.sources.families.primitives import direction, moved, primitive, rotation, turned_to
from vibraverse.sources.families.redraw import OpenShape, coarsely_too_close, main_piece
from vibraverse.sources.families.shape import between
from vibraverse.sources.families.soundness import WALL

#: How often two parts are put together anew before the whole tree is drawn again.
_TRIES = 6
#: Lines that are tried to meet a solid.
_LINES = 30
#: A branch is scaled down where it is joined, so its walls are this much thicker.
_BRANCH = 1.6
#: Least share of a solid's volume that an operation must change, and the largest that it may take away.
_LEAST_CHANGE, _MOST_TAKEN = 0.04, 0.6


@dataclass(frozen=True)
class Tree(OpenShape):
    """A tree of unions, differences and intersections of placed solids."""

    size_range_m = (0.05, 0.4)
    leaves: int = between(3, 9)
    cuts: float = between(0.1, 0.5)
    stretch: float = between(0.4, 1.0)

    def body(self, random: np.random.Generator) -> Manifold | None:
        """Grow the tree, then press it flat or pull it long along some direction."""
        grown = self._grow(random, self.leaves, WALL)
        if grown is None:
            return None
        turn, back = rotation(random), rotation(random)
        return moved(moved(grown, turn, np.zeros(3)).scale([1.0, 1.0, self.stretch]), back, np.zeros(3))

    def _grow(self, random: np.random.Generator, leaves: int, wall: float) -> Manifold | None:
        """Draw a solid with walls of at least ``wall`` longest sides; those of its smaller branch are thicker."""
        if leaves == 1:
            return primitive(random)
        share = 1 if random.random() < 0.5 else int(random.integers(1, leaves // 2 + 1))
        one, other = self._grow(random, leaves - share, wall), self._grow(random, share, _BRANCH * wall)
        if one is None or other is None:
            return None
        for _ in range(_TRIES):
            made = self._joined(random, one, other)
            if made is not None and not coarsely_too_close(made, wall):
                return made
        return None

    def _joined(self, random: np.random.Generator, one: Manifold, other: Manifold) -> Manifold | None:
        """Combine two solids by a random operation, or return None if that changes too little or too much."""
        whole = one.volume()
        scale = random.uniform(0.4, 0.9) * _width(one) / _width(other)
        if random.random() > self.cuts:
            made = one + attached(random, one, other.scale([scale] * 3), (0.1, 0.35))
            changed = made.volume() > (1 + _LEAST_CHANGE) * whole
        elif random.random() < 0.7:
            made = one - attached(random, one, other.scale([0.8 * scale] * 3), (0.3, 1.0))
            changed = _MOST_TAKEN * whole < made.volume() < (1 - _LEAST_CHANGE) * whole
        else:
            size = random.uniform(0.9, 1.3) * _width(one) / _width(other)
            shift = _middle(one) + 0.15 * _width(one) * random.normal(size=3)
            turned = moved(other.translate(list(-_middle(other))).scale([size] * 3), rotation(random), shift)
            made = one ^ turned
            changed = 0.3 * whole < made.volume() < (1 - _LEAST_CHANGE) * whole
        return main_piece(made) if changed else None


def attached(random: np.random.Generator, one: Manifold, other: Manifold, depths) -> Manifold:
    """Return ``other`` placed so that a point of its surface meets one of the first, face to face, and sunk in.

    ``depths`` is the range of how deep it sinks, in shares of its mean width.
    """
    here, outwards = surface_point(random, one)
    there, up = surface_point(random, other)
    turn = turned_to(-outwards, random.uniform(0, 2 * np.pi)) @ turned_to(up, 0.0).T
    depth = random.uniform(*depths) * other.volume() ** (1 / 3)
    return moved(other, turn, here - turn @ there - depth * outwards)


def surface_point(random: np.random.Generator, body: Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Draw a point (3,) of a solid's surface, and return it with the normal there (3,).

    It is where a random line enters the solid, so it depends on the shape alone, and not on its triangles.
    """
    low, high = np.reshape(body.bounding_box(), (2, 3))
    far = np.linalg.norm(high - low)
    for _ in range(_LINES):
        through, along = random.uniform(low, high), direction(random)
        hits = body.ray_cast(list(through - far * along), list(through + far * along))
        if hits:
            hit = hits[0] if random.random() < 0.7 else hits[-1]
            return np.array(hit.position), np.array(hit.normal)
    return high, np.array([0.0, 0.0, 1.0])  # a solid that fills next to nothing of its box


def _width(body: Manifold) -> float:
    low, high = np.reshape(body.bounding_box(), (2, 3))
    return float(np.linalg.norm(high - low))


def _middle(body: Manifold) -> np.ndarray:
    return np.reshape(body.bounding_box(), (2, 3)).mean(axis=0)
