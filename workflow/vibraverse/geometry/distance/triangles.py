"""Distance from a point to a triangle, for compiled loops over many triangles.

The Voronoi regions of corners, edges and inside are tested in turn (Ericson, Real-Time Collision Detection, 2005,
5.1.5).
"""

from __future__ import annotations

import numpy as np
from numba import njit

#: A triangle whose height is below this share of its longest edge counts as that edge, since its inside is lost to
#: rounding.
_SLIVER_ASPECT = 1e-6


def tabulate(corners: np.ndarray) -> np.ndarray:
    """Return the table (F, 12) of triangles (F, 3, 3) that :func:`nearest` reads.

    Columns: the first corner a, the edges ab and ac, and the products ab·ab, ac·ac, ab·ac.
    """
    corners = _without_slivers(corners)
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    products = [np.einsum("fd,fd->f", *pair) for pair in ((ab, ab), (ac, ac), (ab, ac))]
    return np.ascontiguousarray(np.column_stack([corners[:, 0], ab, ac, *products]))


def _without_slivers(corners: np.ndarray) -> np.ndarray:
    """Return the triangles with slivers replaced by their longest edge, as triangles with two equal corners."""
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(edges, axis=2)
    longest, row = lengths.argmax(axis=1), np.arange(len(corners))
    twice_area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    thin = twice_area <= _SLIVER_ASPECT * lengths[row, longest] ** 2
    start, stop = corners[row, longest], corners[row, (longest + 1) % 3]
    return np.where(thin[:, None, None], np.stack([start, stop, stop], axis=1), corners)


@njit(cache=True, nogil=True)
def nearest(p0, p1, p2, table, i):
    """Return barycentric coordinates v, w of the point of triangle ``i`` nearest to p, and its squared distance.

    The point is ``a + v ab + w ac``. The products at the other two corners follow from those at the first.
    """
    x, y, z = p0 - table[i, 0], p1 - table[i, 1], p2 - table[i, 2]
    d1 = table[i, 3] * x + table[i, 4] * y + table[i, 5] * z
    d2 = table[i, 6] * x + table[i, 7] * y + table[i, 8] * z
    d3, d4 = d1 - table[i, 9], d2 - table[i, 11]
    d5, d6 = d1 - table[i, 11], d2 - table[i, 10]
    v = w = 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        return v, w, x * x + y * y + z * z
    if d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    else:
        vc, vb, va = d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4
        if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
            v = d1 / (d1 - d3)
        elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
            w = d2 / (d2 - d6)
        elif va <= 0.0 and d4 >= d3 and d5 >= d6:
            w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
            v = 1.0 - w
        else:
            scale = 1.0 / (va + vb + vc)
            v, w = vb * scale, vc * scale
    x -= v * table[i, 3] + w * table[i, 6]
    y -= v * table[i, 4] + w * table[i, 7]
    z -= v * table[i, 5] + w * table[i, 8]
    return v, w, x * x + y * y + z * z
