"""Thickening an open sheet: both sides moved out by half the thickness, and the rims closed."""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import Mesh, surfaces

#: A vertex moves by at most this many half thicknesses, however sharp the fold it is on.
_MITRE = 3.0
#: Weight that keeps a vertex from moving along the sheet.
_ALONG = 1e-6


def thicken(vertices: np.ndarray, faces: np.ndarray, thickness: float) -> Mesh:
    """Return the plate around an oriented sheet (V, 3), (F, 3), closed, its triangles at half the thickness on both
    sides.

    A vertex moves by ``d t/2`` with ``n·d = 1`` for the normals of all faces around, or as nearly as can be; so a flat
    sheet of area A becomes a plate of volume ``A t``, and a folded one keeps its thickness along the fold. The plate
    cuts itself where the sheet bends more tightly than half its thickness.
    """
    edge, count = surfaces.edge_numbers(faces)
    # Where the sheet only touches itself in a point, every fan of faces gets its own.
    fan, source = surfaces.fans(faces, edge)
    points, faces = vertices[source], fan.reshape(-1, 3)
    step = 0.5 * thickness * _mitred(points, faces)
    n = len(points)
    rim = surfaces.half_edges(faces)[count[edge] == 1]
    a, b = rim.T
    sides = np.concatenate([np.stack([b, a, a + n], axis=1), np.stack([b, a + n, b + n], axis=1)])
    return np.concatenate([points + step, points - step]), np.concatenate([faces, faces[:, ::-1] + n, sides])


def _mitred(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return d (V, 3) with ``n·d = 1`` for the normals around in the sense of least squares, weighted by area."""
    d = surfaces.steps_to_heights(points, faces, 1.0, _ALONG)
    return d * np.minimum(1.0, _MITRE / np.maximum(np.linalg.norm(d, axis=1), 1e-300))[:, None]
