"""Where a body's elements must be smaller than elsewhere.

At a re-entrant edge the stress is infinite: near an inner angle of 270° displacements go like the distance to the power
0.54, and elements of one size converge no better than that, whatever their order. Elements that shrink towards the
edge in proportion to the distance restore the order at little cost, because the edge is only a line. (Babuška, Kellogg
and Pitkäranta, Numer. Math. 33, 1979.)
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.closest import ClosestPoint
from vibraverse.geometry.ridges import reentrant_ridges

#: Edges at which the surface bends inwards by more than this count as re-entrant.
_REENTRANT_DEG = 30.0
#: Ridges that extend less than this many sizes are left out.
_SHORTEST = 1.0
#: The size at a re-entrant edge as a share of that elsewhere, and how much it grows per length of distance.
_SHARE, _GROWTH = 0.3, 0.4
#: When re-entrant ridges are many, refining all of them would leave too few elements for the rest: where strips of one
#: size along them cover less than the first share of the surface they are refined fully, beyond the second not at all.
_OCCUPIED = (0.2, 0.6)
#: Edges of the input longer than this many sizes are split, so that sizes given at vertices can vary along them.
_LONG = 2.0


def sized(vertices: np.ndarray, faces: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a closed surface (V, 3), (F, 3) and the wanted edge lengths at its vertices (V,).

    They are ``size`` far from re-entrant ridges and less near them. Where the surface's own triangles are too large for
    sizes at their corners to say so, they are split.
    """
    edges = reentrant_ridges(vertices, faces, _REENTRANT_DEG, _SHORTEST * size)
    if not len(edges):
        return vertices, faces, np.full(len(vertices), float(size))
    lines = vertices[edges]
    length = float(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum())
    share = np.interp(length * size / surfaces.area(vertices, faces), _OCCUPIED, (_SHARE, 1.0))
    distance = ClosestPoint(vertices, np.column_stack([edges, edges[:, 1]])).distance
    vertices, faces = repair.split(vertices, faces, _LONG * size)
    return vertices, faces, np.minimum(share * size + _GROWTH * distance(vertices), size)
