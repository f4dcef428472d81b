"""Shrink-wrapping: a closed surface around any soup, moved back onto it.

An alpha wrap (Portaneri et al., 2022) is a surface a given distance outside the soup that enters no gap narrower than a
given radius. It is made as finely as the holes allow and then moved back by its distance where the body is thick
enough for that. What is thinner becomes a plate of twice the distance.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.distance.sight import depth_below
from vibraverse.geometry.meshing.remesh import move

#: A wrap moves back in at most so many steps; each is left out where the wrap would cut itself.
_STEPS = 8
#: Vertices farther from the soup than this many distances span a gap and move along their normals.
_SPANNING = 1.2
#: Moving ends when nothing moves by more than this share of the distance.
_STILL = 0.02


def draw_in(points: np.ndarray, triangles: np.ndarray, distance: float, soup: Mesh) -> Mesh:
    """Return a wrap moved back by its ``distance`` onto the soup, where the body is thick enough for it.

    What is thinner than twice the distance stays that thick, so that sheets become plates that can be meshed.
    """
    normals = surfaces.vertex_normals(points, triangles)
    room = 0.5 * _thickness(points, triangles, normals, 6 * distance) - distance
    towards = ClosestPoint(*soup)(points) - points
    away = np.linalg.norm(towards, axis=1, keepdims=True)
    spans = away > _SPANNING * distance
    towards = np.where(spans, -normals, towards / np.maximum(away, 1e-300))
    wanted = points + np.clip(room, 0.0, distance)[:, None] * towards
    free = np.ones(len(points), dtype=bool)
    for _ in range(_STEPS):
        drawn = move(points, np.where(free[:, None], wanted - points, 0.0), triangles)
        crossing = crossing_faces(drawn, triangles)
        while crossing.any():
            free[triangles[crossing]] = False
            drawn = np.where(free[:, None], drawn, points)
            crossing = crossing_faces(drawn, triangles)
        moved = np.linalg.norm(drawn - points, axis=1).max()
        points = drawn
        if moved < _STILL * distance:
            break
    return points, triangles


def _thickness(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, most: float) -> np.ndarray:
    """Return how thick the body is below every vertex (V,), up to ``most``: the least around each vertex."""
    across = depth_below(points, triangles, normals, most)
    for _ in range(2):
        least = across[triangles].min(axis=1)
        np.minimum.at(across, triangles.ravel(), np.repeat(least, 3))
    return across
