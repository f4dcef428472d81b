"""Cells of [-1, 1]³: their centres, and the surface of those that are occupied.

Sample ``i`` of ``n`` lies at ``x_i = -1 + (2i+1)/n`` along each axis; arrays are indexed ``[ix, iy, iz]``.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import Mesh


def cell_centres(n: int) -> np.ndarray:
    """Return the sample positions along one axis, (n,) float64."""
    return -1.0 + (2.0 * np.arange(n) + 1.0) / n


def coarse_mesh(occupied: np.ndarray) -> Mesh:
    """Return the box mesh of an occupancy grid: vertices (V, 3) in [-1, 1]³ and outward triangles (F, 3).

    Every side between an occupied and an empty cell becomes two triangles; corners are shared. The surface touches
    itself where cells meet only along an edge or at a corner.
    """
    n = np.array(occupied.shape)
    padded = np.pad(occupied.astype(np.int8), 1)
    quads = []
    for axis in range(3):
        step = np.diff(padded, axis=axis)
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for sign in (1, -1):
            # The step is +1 where a body begins; there the outward normal points down the axis.
            at = np.argwhere(step == sign)
            corner = at - 1
            corner[:, axis] += 1
            ring = np.zeros((len(at), 4, 3), dtype=np.int64)
            ring[:] = corner[:, None, :]
            ring[:, 1, u] += 1
            ring[:, 2, [u, v]] += 1
            ring[:, 3, v] += 1
            quads.append(ring[:, ::-1] if sign == 1 else ring)
    rings = np.concatenate(quads)
    keys = rings @ np.array([(n[1] + 1) * (n[2] + 1), n[2] + 1, 1])
    _, first, index = np.unique(keys, return_index=True, return_inverse=True)
    corners = -1.0 + 2.0 * rings.reshape(-1, 3)[first] / n
    index = index.reshape(-1, 4)
    return corners, np.concatenate([index[:, [0, 1, 2]], index[:, [0, 2, 3]]])
