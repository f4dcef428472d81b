"""The boundary of tetrahedra."""

from __future__ import annotations

import numpy as np


def boundary(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the boundary of tetrahedra (T, 4): outward triangles (F, 3) and the points that they use (V,), ascending.

    The triangles index into those points.
    """
    faces = cells[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    faces = faces[np.sort(first[count == 1])]
    nodes, index = np.unique(faces, return_inverse=True)
    return index.reshape(-1, 3).astype(np.int32), nodes
