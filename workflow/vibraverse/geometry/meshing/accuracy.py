"""How far the surface of a mesh is from the surface it was made of."""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.distance.closest import ClosestPoint

#: Most points of the given surface from which the distance to the mesh is measured.
_MAX_POINTS = 20_000


def accuracy(given: Mesh, made: Mesh) -> dict[str, float]:
    """Return what meshing changed: distances as shares of the diagonal, and the relative change of the volume.

    ``given`` is the closed surface (V, 3), (F, 3) of the body, ``made`` the boundary of its tetrahedra. Distances start
    at the points of a surface and at the centres of its triangles.
    """
    diagonal = float(np.linalg.norm(np.ptp(given[0], axis=0)))
    there, here = _probes(*given), _probes(*made)
    there = there[:: len(there) // _MAX_POINTS + 1]
    lost, made_up = ClosestPoint(*made).distance(there), ClosestPoint(*given).distance(here)
    return {
        "surface_to_mesh": _rounded(lost.max() / diagonal),
        "mesh_to_surface": _rounded(made_up.max() / diagonal),
        "mean_mesh_to_surface": _rounded(made_up.mean() / diagonal),
        "volume_change": _rounded(surfaces.volume(*made) / surfaces.volume(*given) - 1),
    }


def _probes(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    return np.concatenate([vertices, vertices[faces].mean(axis=1)])


def _rounded(value: float) -> float:
    """Return a number with the digits that a reader needs; a share below 1e-9 is rounding."""
    return float(f"{value:.3g}") if abs(value) > 1e-9 else 0.0
