"""Numbers of a solid that rotating, mirroring, moving, scaling and triangulating it anew do not change.

With ``C = ∫ x xᵀ dV`` about the centre of mass: the eigenvalues of ``C / V^(5/3)`` and the area over ``V^(2/3)``.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import surfaces


def scale_free_moments(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the three eigenvalues, ascending, and the area of a closed surface (V, 3), (F, 3), scale-free: (4,)."""
    volume, _, second = second_moments(vertices, faces)
    spread = np.linalg.eigvalsh(second) / volume ** (5 / 3)
    return np.append(spread, surfaces.area(vertices, faces) / volume ** (2 / 3))


def principal_axes(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of mass (3,) of a solid and its principal axes as the columns of a rotation (3, 3).

    They turn with the body. Where it is as wide one way as another, any axes of that plane may come out.
    """
    _, centre, second = second_moments(vertices, faces)
    axes = np.linalg.eigh(second)[1]
    return centre, axes * np.linalg.det(axes)


def second_moments(vertices: np.ndarray, faces: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the volume, the centre of mass (3,) and ``C`` (3, 3) of what a closed surface (V, 3), (F, 3) encloses.

    The integrals are exact: every triangle and the origin span a tetrahedron whose moments are known.
    """
    volume = surfaces.volume(vertices, faces)
    a, b, c = surfaces.corners(vertices, faces)
    weights = np.einsum("ij,ij->i", a, np.cross(b, c))
    centre = (weights @ (a + b + c)) / (24.0 * volume)
    a, b, c = a - centre, b - centre, c - centre
    weights = np.einsum("ij,ij->i", a, np.cross(b, c))
    second = sum((weights[:, None] * p).T @ p for p in (a, b, c, a + b + c)) / 120.0
    return volume, centre, second
