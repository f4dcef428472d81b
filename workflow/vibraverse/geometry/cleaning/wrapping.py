"""Shrink-wrapping: a closed surface around any soup, moved back onto it.

An alpha wrap (Portaneri et al., ACM Trans. Graph. 41(4), 2022) lies at a given distance outside the soup and enters no
gap narrower than a given radius. It is as fine as the holes allow. Where the body is thick enough, the wrap moves back
by its distance; thinner parts become plates of twice the distance.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.distance.boxes import contains
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.distance.sight import depth_below
from vibraverse.geometry.meshing.remesh import move

#: Most steps in which a wrap moves back. Vertices stop where the wrap would cut itself.
_MAX_STEPS = 8
#: Vertices farther from the soup than this many wrap distances span a gap; they move along their normals.
_GAP_DISTANCE = 1.2
#: The motion ends when no vertex moves by more than this share of the distance.
_MIN_MOVE = 0.02
#: Most points of a piece that show whether a wrap holds it.
_MAX_PROBES = 100


def draw_in(points: np.ndarray, triangles: np.ndarray, distance: float, soup: Mesh) -> Mesh:
    """Return a wrap moved back by its ``distance`` onto the soup, where the body is thick enough.

    Thinner parts keep a thickness of twice the distance, so that sheets become plates that can be meshed.
    """
    normals = surfaces.vertex_normals(points, triangles)
    room = 0.5 * _thickness(points, triangles, normals, 6 * distance) - distance
    towards = ClosestPoint(*soup)(points) - points
    away = np.linalg.norm(towards, axis=1, keepdims=True)
    spans = away > _GAP_DISTANCE * distance
    towards = np.where(spans, -normals, towards / np.maximum(away, 1e-300))
    wanted = points + np.clip(room, 0.0, distance)[:, None] * towards
    free = np.ones(len(points), dtype=bool)
    for _ in range(_MAX_STEPS):
        drawn = move(points, np.where(free[:, None], wanted - points, 0.0), triangles)
        crossing = crossing_faces(drawn, triangles)
        while crossing.any():
            free[triangles[crossing]] = False
            drawn = np.where(free[:, None], drawn, points)
            crossing = crossing_faces(drawn, triangles)
        moved = np.linalg.norm(drawn - points, axis=1).max()
        points = drawn
        if moved < _MIN_MOVE * distance:
            break
    return points, triangles


def holds(body: Mesh, piece: Mesh, distance: float) -> bool:
    """Return whether most of a piece lies in a body, or nearer to its surface than a share of the diagonal."""
    points = piece[0][:: len(piece[0]) // _MAX_PROBES + 1]
    near = ClosestPoint(*body).distance(points) < distance * np.linalg.norm(np.ptp(body[0], axis=0))
    return bool((near | contains(*body, points)).mean() > 0.5)


def _thickness(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, most: float) -> np.ndarray:
    """Return the smallest thickness of the body around every vertex (V,), at most ``most``."""
    across = depth_below(points, triangles, normals, most)
    for _ in range(2):
        least = across[triangles].min(axis=1)
        np.minimum.at(across, triangles.ravel(), np.repeat(least, 3))
    return across
