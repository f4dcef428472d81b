"""Shrink-wrapping: a closed surface around any soup, moved back onto it.

An alpha wrap (Portaneri et al., 2022) is a surface a given distance outside the soup that enters no gap narrower than a
given radius. It is made as finely as the holes allow and then moved back by its distance where the body is thick
enough for that. What is thinner becomes a plate of twice the distance.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import surfaces
from vibraverse.geometry.crossing import crossing_faces
from vibraverse.geometry.remesh import move
from vibraverse.geometry.sight import LineOfSight

Mesh = tuple[np.ndarray, np.ndarray]

#: How often a wrap is drawn in again after leaving out where it would cut itself.
_DRAW_ROUNDS = 8


def draw_in(points: np.ndarray, triangles: np.ndarray, distance: float) -> Mesh:
    """Return a wrap moved back by its ``distance`` from the soup, where the body is thick enough for it.

    What is thinner than twice the distance stays that thick, so that sheets become plates that can be meshed.
    """
    normals = surfaces.vertex_normals(points, triangles)
    room = 0.5 * _thickness(points, triangles, normals, 6 * distance) - distance
    step = -np.clip(room, 0.0, distance)[:, None] * normals
    for _ in range(_DRAW_ROUNDS):
        drawn = move(points, step, triangles)
        crossing = crossing_faces(drawn, triangles)
        if not crossing.any():
            return drawn, triangles
        step[np.unique(triangles[crossing])] = 0.0
    return points, triangles


def _thickness(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, most: float) -> np.ndarray:
    """Return how thick the body is below every vertex (V,), up to ``most``: the least around each vertex."""
    starts = points - 1e-3 * most * normals
    across = most * LineOfSight(points, triangles).first_hit(starts, starts - most * normals)
    for _ in range(2):
        least = across[triangles].min(axis=1)
        np.minimum.at(across, triangles.ravel(), np.repeat(least, 3))
    return across
