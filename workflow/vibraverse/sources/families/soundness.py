"""What makes a drawn body worth keeping: one closed piece, thick enough walls, wide enough gaps, good triangles.

All lengths are shares of the longest side, which is 1.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from vibraverse.geometry import surfaces

#: Least thickness of walls and least width of gaps.
WALL, GAP = 0.045, 0.02
#: Shares of the area that may belong to thinner walls (edges of wedges) and to narrower gaps (bottoms of notches).
_THIN_AREA, _NARROW_AREA = 0.015, 0.04
#: Faces are opposite if their normals turn by more than about 135 degrees.
_OPPOSITE = -0.7
_LEAST_VOLUME = 0.0035
_COUNTS = (2000, 20_000)
#: Quality of triangles, 1 for an equilateral one: of all but one in a hundred, and the median.
_QUALITY, _MEDIAN_QUALITY = 0.42, 0.82


def flaw(vertices: np.ndarray, faces: np.ndarray) -> str | None:
    """Return what is wrong with a surface of any size, or None; its coordinates are taken as they will be stored."""
    if not _COUNTS[0] <= len(faces) <= _COUNTS[1]:
        return f"{len(faces)} triangles"
    found = surfaces.topology(faces, len(vertices))
    if not found.closed_manifold or found.components > 1 or len(np.unique(faces)) < len(vertices):
        return "not one closed piece"
    unit = vertices / np.ptp(vertices, axis=0).max()
    if surfaces.volume(unit, faces) < _LEAST_VOLUME:
        return "too little volume"
    if np.ptp(unit, axis=0).min() < WALL:
        return "too flat"
    if _poor(unit, faces):
        return "poor triangles"
    if too_close(unit, faces):
        return "thin walls or narrow gaps"
    return "intersects itself" if intersects_itself(vertices, faces) else None


def too_close(vertices: np.ndarray, faces: np.ndarray, wall: float = WALL) -> bool:
    """Return whether walls are thinner than ``wall`` or gaps too narrow; edges are to be shorter than that.

    Two faces bound a wall or a gap if their normals are opposite and one lies straight in front of the other.
    """
    normals, areas = surfaces.normals_and_areas(vertices, faces)
    points = np.mean(surfaces.corners(vertices, faces), axis=0)
    pairs = cKDTree(points).query_pairs(wall, output_type="ndarray")
    one, other = pairs[(normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1) < _OPPOSITE].T
    apart = points[other] - points[one]
    mean = normals[one] - normals[other]
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    height = (apart * mean).sum(axis=1)  # negative across a wall, positive across a gap
    aside = np.linalg.norm(apart - height[:, None] * mean, axis=1)
    reach = np.sqrt(np.maximum(areas[one], areas[other]))
    facing = aside < reach
    return any(
        _area(areas, one[close], other[close]) > most * areas.sum()
        for close, most in (
            (facing & (height < 0), _THIN_AREA),
            (facing & (height >= 0) & (height < GAP), _NARROW_AREA),
        )
    )


def _area(areas: np.ndarray, *faces: np.ndarray) -> float:
    """Return the area of some faces, each counted once."""
    return float(areas[np.unique(np.concatenate(faces))].sum())


def intersects_itself(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Return whether any two triangles meet beyond the points and edges that they share."""
    from vibraverse.geometry.distance.crossing import crossing_faces

    return bool(crossing_faces(vertices, faces).any())


def _poor(vertices: np.ndarray, faces: np.ndarray) -> bool:
    areas = surfaces.normals_and_areas(vertices, faces)[1]
    quality = 4 * np.sqrt(3) * areas / (surfaces.edge_lengths(vertices, faces) ** 2).sum(axis=1)
    return bool(np.quantile(quality, 0.01) < _QUALITY or np.median(quality) < _MEDIAN_QUALITY)
