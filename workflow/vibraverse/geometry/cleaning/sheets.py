"""Thickening of an open sheet: both sides move out by half the thickness, and the rims are closed."""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import Mesh, surfaces

#: Largest step of a vertex in half thicknesses, however sharp its fold.
_MITRE_LIMIT = 3.0
#: Weight that keeps a vertex from moving along the sheet.
_STIFFNESS = 1e-6


def thicken(vertices: np.ndarray, faces: np.ndarray, thickness: float) -> Mesh:
    """Return the closed plate around an oriented sheet (V, 3), (F, 3).

    A vertex moves by ``d t/2``, where ``n·d = 1`` for the normals of all faces around it, in the least-squares sense.
    So a flat sheet of area A becomes a plate of volume ``A t``, and a folded one keeps its thickness along the fold.
    The plate cuts itself where the sheet bends more tightly than half its thickness.
    """
    edge, count = surfaces.edge_numbers(faces)
    # Where the sheet touches itself in a single point, every fan of faces gets its own copy.
    fan, source = surfaces.fans(faces, edge)
    points, faces = vertices[source], fan.reshape(-1, 3)
    step = 0.5 * thickness * _mitred(points, faces)
    n = len(points)
    rim = surfaces.half_edges(faces)[count[edge] == 1]
    a, b = rim.T
    sides = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    return np.concatenate([points + step, points - step]), np.concatenate([faces, faces[:, ::-1] + n, sides])


def _mitred(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return d (V, 3) with ``n·d = 1`` for the normals around each vertex: least squares weighted by area."""
    d = surfaces.steps_to_heights(points, faces, 1.0, _STIFFNESS)
    return d * np.minimum(1.0, _MITRE_LIMIT / np.maximum(np.linalg.norm(d, axis=1), 1e-300))[:, None]
