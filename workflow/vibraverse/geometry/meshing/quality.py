"""Quality measures of tetrahedra, on which the accuracy of a finite-element solution depends."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

_FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
_EDGES = np.array(list(combinations(range(4), 2)))


def volumes(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the signed volume of every tetrahedron, (T,)."""
    a = points[cells[:, 0]]
    b, c, d = (points[cells[:, i]] - a for i in (1, 2, 3))
    return np.einsum("ij,ij->i", np.cross(b, c), d) / 6.0


def _face_normals(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return outward unit normals (T, 4, 3) and areas (T, 4) of the four faces."""
    p = points[cells[:, _FACES]]
    cross = np.cross(p[:, :, 1] - p[:, :, 0], p[:, :, 2] - p[:, :, 0])
    length = np.linalg.norm(cross, axis=2)
    return cross / np.maximum(length, 1e-300)[:, :, None], 0.5 * length


def min_dihedral_deg(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the smallest angle between two faces of every tetrahedron in degrees, (T,); regular: 70.5."""
    normals, _ = _face_normals(points, cells)
    cosines = np.stack([-np.einsum("ij,ij->i", normals[:, i], normals[:, j]) for i, j in _EDGES], axis=1)
    return np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0).max(axis=1)))


def radius_ratios(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return ``3 r_in / r_circum`` of every tetrahedron, (T,): 1 when regular, 0 when flat."""
    volume = np.abs(volumes(points, cells))
    areas = _face_normals(points, cells)[1].sum(axis=1)
    p = points[cells]
    edge = [np.linalg.norm(p[:, j] - p[:, i], axis=1) for i, j in _EDGES]
    x, y, z = edge[0] * edge[5], edge[1] * edge[4], edge[2] * edge[3]
    # The products of opposite edges are the sides of a triangle with the area 6 V r_circum.
    area = (x + y + z) * (y + z - x) * (z + x - y) * (x + y - z)
    circum_times_volume = np.sqrt(np.maximum(area, 0.0)) / 24.0
    return 9.0 * volume**2 / np.maximum(areas * circum_times_volume, 1e-300)


def parts(cells: np.ndarray, n_points: int) -> int:
    """Return the number of connected parts; a point that no tetrahedron uses counts as a part."""
    rows, columns = np.repeat(cells[:, 0], 3), cells[:, 1:].ravel()
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(n_points, n_points))
    return int(connected_components(graph, directed=False)[0])


def table(points: np.ndarray, cells: np.ndarray) -> dict:
    """Return the quality table of a mesh; lengths in the units of the points."""
    angle, ratio = min_dihedral_deg(points, cells), radius_ratios(points, cells)
    p = points[cells]
    edge = np.stack([np.linalg.norm(p[:, j] - p[:, i], axis=1) for i, j in _EDGES], axis=1)
    aspect = edge.max(axis=1) / edge.min(axis=1)
    return {
        "min_dihedral_deg": _percentiles(angle, (0, 1, 5, 50)),
        "radius_ratio": _percentiles(ratio, (0, 1, 5, 50)),
        "edge_length": _percentiles(edge, (0, 5, 50, 95, 100)),
        "edge_aspect": _percentiles(aspect, (50, 95, 100)),
        "slivers": int((angle < 5.0).sum()),
    }


def _percentiles(values: np.ndarray, percents) -> dict:
    names = {0: "min", 50: "median", 100: "max"}
    found = np.percentile(values, percents)
    return {names.get(q, f"p{q:02d}"): round(float(v), 6) for q, v in zip(percents, found, strict=True)}
