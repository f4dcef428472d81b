"""Where a body's elements must be smaller than elsewhere.

At a re-entrant edge the stress is infinite: near an inner angle of 270° displacements go like the distance to the power
0.54, and elements of one size converge no better than that, whatever their order. Elements that shrink towards the
edge in proportion to the distance restore the order at little cost, because the edge is only a line. (Babuška, Kellogg
and Pitkäranta, Numer. Math. 33, 1979.)
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import surfaces
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.meshing.ridges import reentrant_ridges

#: Edges at which the surface bends inwards by more than this count as re-entrant.
_REENTRANT_DEG = 30.0
#: Ridges that extend less than this many sizes are left out.
_SHORTEST = 1.0
#: The size at a re-entrant edge as a share of that elsewhere, and how much it grows per length of distance.
_SHARE, _GROWTH = 0.15, 0.5
#: When re-entrant ridges are many, refining all of them would leave too few elements for the rest: where strips of one
#: size along them cover less than the first share of the surface they are refined fully, beyond the second not at all.
_OCCUPIED = (0.2, 0.6)


class Sizing:
    """The edge lengths that a closed surface (V, 3), (F, 3) needs when they are about ``size`` on most of it."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, size: float):
        edges = reentrant_ridges(vertices, faces, _REENTRANT_DEG, _SHORTEST * size)
        lines = vertices[edges]
        self._length = float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum())
        self._area = surfaces.area(vertices, faces)
        triangles = np.column_stack([edges, edges[:, 1]])
        self._distance = ClosestPoint(vertices, triangles).distance if len(edges) else None

    def __call__(self, points: np.ndarray, size: float) -> np.ndarray:
        """Return the lengths (P,) wanted at points (P, 3): ``size`` far from re-entrant ridges, less near them."""
        if self._distance is None:
            return np.full(len(points), float(size))
        share = np.interp(self._length * size / self._area, _OCCUPIED, (_SHARE, 1.0))
        return np.minimum(share * size + _GROWTH * self._distance(points), size)
