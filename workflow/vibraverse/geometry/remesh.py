"""Remesh a closed surface to a wanted triangle size without losing its shape or its volume.

Triangles inscribed in a curved surface lose volume, and a body's frequencies follow: an inscribed sphere rings
too high. So the surface is remade in two steps. Mmg finds the ridges and makes well-shaped triangles within a
bounded distance of the surface. Then the vertices move so that every triangle lies half inside and half
outside the original: the mean height ``h_f`` of the original above face ``f`` is measured at three points, and
each vertex takes the displacement ``u`` that minimises ``Σ_f A_f (n_f·u - h_f)² + ε Σ_f A_f |u|²`` over its faces.
Planes and ridges stay where they are because the original has no height above their faces. A last common
factor on the displacements makes the volume that of the original.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry.closest import ClosestPoint
from vibraverse.geometry.surfaces import edge_lengths, normals_and_areas, volume

#: Sample points inside a triangle whose mean is exact for quadratic heights.
_SAMPLES = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0
#: Weight ε that keeps a vertex from sliding along its surface.
_STIFFNESS = 0.05
_ROUNDS = 3


def remesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    size: float,
    deviation: float = 0.06,
    ridge_deg: float = 25.0,
    fit: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the closed surface remade with edges of at most ``size``.

    ``deviation`` bounds the distance from the original in units of ``size``: where the surface bends, triangles
    shrink until they keep it. An edge at which the normal turns by more than ``ridge_deg`` stays sharp. With
    ``fit`` the vertices are moved for the same volume. Raises ``RuntimeError`` when Mmg fails.
    """
    from mmgpy import MmgMeshS

    mesh = MmgMeshS(np.ascontiguousarray(vertices, dtype=np.float64), faces.astype(np.int32))
    mesh.remesh(
        hmax=size, hmin=0.3 * size, hausd=deviation * size, hgrad=1.4, ar=ridge_deg, verbose=-1
    )
    points, triangles = mesh.get_vertices().copy(), mesh.get_triangles().astype(np.int64)
    if fit:
        points = fit_to(vertices, faces, points, triangles)
    return points, triangles


def fit_to(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Return ``points`` moved so that ``triangles`` deviate from the original evenly, with its volume.

    The original surface is ``vertices`` and ``faces``; ``points`` (P, 3) are near it.
    """
    closest = ClosestPoint(vertices, faces)
    base = move(points, closest(points) - points, triangles)
    fitted = base
    for _ in range(_ROUNDS):
        fitted = move(fitted, _displacements(fitted, triangles, closest), triangles)
    return _match_volume(base, fitted, triangles, volume(vertices, faces))


def _displacements(points: np.ndarray, triangles: np.ndarray, closest: ClosestPoint) -> np.ndarray:
    """Return the least-squares displacement of every vertex, (P, 3)."""
    normals, areas = normals_and_areas(points, triangles)
    samples = np.einsum("sc,fcd->fsd", _SAMPLES, points[triangles])
    offsets = closest(samples.reshape(-1, 3)).reshape(samples.shape) - samples
    heights = np.einsum("fsd,fd->f", offsets, normals) / len(_SAMPLES)
    corner = triangles.ravel()
    matrix, vector = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    np.add.at(
        matrix, corner, np.repeat(areas[:, None, None] * normals[:, :, None] * normals[:, None, :], 3, axis=0)
    )
    np.add.at(vector, corner, np.repeat((areas * heights)[:, None] * normals, 3, axis=0))
    weight = np.trace(matrix, axis1=1, axis2=2)
    matrix += (_STIFFNESS * weight + (weight == 0))[:, None, None] * np.eye(3)
    return np.linalg.solve(matrix, vector[:, :, None])[:, :, 0]


def move(points: np.ndarray, step: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return ``points + step``, with a step left out where it would be long or turn a face over."""
    shortest = np.full(len(points), np.inf)
    np.minimum.at(shortest, triangles.ravel(), np.repeat(edge_lengths(points, triangles).min(axis=1), 3))
    length = np.linalg.norm(step, axis=1)
    step = step * np.minimum(1.0, 0.3 * shortest / np.maximum(length, 1e-300))[:, None]
    before = normals_and_areas(points, triangles)[0]
    for _ in range(10):
        after = normals_and_areas(points + step, triangles)[0]
        turned = np.einsum("ij,ij->i", before, after) < 0.7
        if not turned.any():
            break
        step = step.copy()
        step[np.unique(triangles[turned])] = 0.0
    return points + step


def _match_volume(
    base: np.ndarray, fitted: np.ndarray, triangles: np.ndarray, wanted: float
) -> np.ndarray:
    """Return ``base + s (fitted - base)`` with ``s`` near 1 such that the enclosed volume is ``wanted``."""
    step = fitted - base
    scale, now = 1.0, volume(fitted, triangles)
    for _ in range(8):
        slope = (volume(base + (scale + 1e-3) * step, triangles) - now) / 1e-3
        if abs(slope) <= 1e-6 * abs(wanted) or abs(wanted - now) <= 1e-13 * abs(wanted):
            break
        scale = float(np.clip(scale + (wanted - now) / slope, 0.5, 1.5))
        now = volume(base + scale * step, triangles)
    return base + scale * step
