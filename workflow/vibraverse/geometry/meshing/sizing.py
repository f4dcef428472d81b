"""Element sizes, graded towards re-entrant edges.

The stress is infinite at a re-entrant edge. Near an inner angle of 270° displacements grow as the distance to the power
0.54, and a uniform mesh converges no faster than that, whatever the order of its elements. Elements that shrink in
proportion to the distance restore the order at little cost, because the edge is only a line. (Babuška, Kellogg and
Pitkäranta, Numer. Math. 33, 1979.)
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import surfaces
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.meshing.ridges import reentrant_ridges

#: An edge is re-entrant if the surface bends inwards there by more than this.
_REENTRANT_DEG = 30.0
#: Ridges that extend less than this many sizes are left out.
_MIN_RIDGE_LENGTH = 1.0
#: Element size at a re-entrant edge as a share of that elsewhere, and its growth per unit of distance.
_EDGE_SIZE, _GROWTH_RATE = 0.15, 0.5
#: Refining many re-entrant ridges would leave too few elements for the rest. Ridges are refined fully while strips of
#: one size along them cover less than the first share of the surface, and not at all beyond the second.
_COVERAGE_LIMITS = (0.2, 0.6)


class Sizing:
    """Wanted edge lengths on a closed surface (V, 3), (F, 3), about ``size`` on most of it."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, size: float):
        edges = reentrant_ridges(vertices, faces, _REENTRANT_DEG, _MIN_RIDGE_LENGTH * size)
        lines = vertices[edges]
        self._length = float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum())
        self._area = surfaces.area(vertices, faces)
        triangles = np.column_stack([edges, edges[:, 1]])
        self._distance = ClosestPoint(vertices, triangles).distance if len(edges) else None

    def __call__(self, points: np.ndarray, size: float) -> np.ndarray:
        """Return the wanted lengths (P,) at points (P, 3): ``size`` far from re-entrant ridges, less near them."""
        if self._distance is None:
            return np.full(len(points), float(size))
        share = np.interp(self._length * size / self._area, _COVERAGE_LIMITS, (_EDGE_SIZE, 1.0))
        return np.minimum(share * size + _GROWTH_RATE * self._distance(points), size)
