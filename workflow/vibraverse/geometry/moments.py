"""Moments of a solid, and invariants made of them.

``C = ∫ x xᵀ dV`` is taken about the centre of mass. The eigenvalues of ``C / V^(5/3)`` and the area over ``V^(2/3)``
are invariant under rotation, mirroring, translation, scaling and another triangulation.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import surfaces


def scale_free_moments(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the invariants (4,) of a closed surface (V, 3), (F, 3): three ascending eigenvalues, then the area."""
    volume, _, second = second_moments(vertices, faces)
    spread = np.linalg.eigvalsh(second) / volume ** (5 / 3)
    return np.append(spread, surfaces.area(vertices, faces) / volume ** (2 / 3))


def principal_axes(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of mass (3,) of a solid and its principal axes as the columns of a rotation (3, 3).

    The axes turn with the body. Those of equal moments are arbitrary within their plane.
    """
    _, centre, second = second_moments(vertices, faces)
    axes = np.linalg.eigh(second)[1]
    return centre, axes * np.linalg.det(axes)


def principal_box(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the principal axes (3, 3) of a solid and the corners (3,) of its box along them, lowest and highest."""
    axes = principal_axes(vertices, faces)[1]
    used = vertices[np.unique(faces)] @ axes
    return axes, used.min(axis=0), used.max(axis=0)


def second_moments(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return volume, centre of mass (3,) and ``C`` (3, 3) of the solid in a closed surface (V, 3), (F, 3).

    The integrals are exact: each triangle spans a tetrahedron with the origin, whose moments are known.
    """
    volume = surfaces.volume(vertices, faces)
    a, b, c = surfaces.corners(vertices, faces)
    weights = np.einsum("ij,ij->i", a, np.cross(b, c))
    centre = (weights @ (a + b + c)) / (24.0 * volume)
    a, b, c = a - centre, b - centre, c - centre
    weights = np.einsum("ij,ij->i", a, np.cross(b, c))
    second = sum((weights[:, None] * p).T @ p for p in (a, b, c, a + b + c)) / 120.0
    return volume, centre, second
