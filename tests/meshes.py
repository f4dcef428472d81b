"""Tetrahedral meshes for tests of the physics."""

from __future__ import annotations

import numpy as np


def oriented(points: np.ndarray, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh with every tetrahedron positively oriented."""
    corners = points[cells]
    edges = corners[:, 1:] - corners[:, :1]
    cells = cells.copy()
    flipped = np.linalg.det(edges) < 0
    cells[flipped] = cells[flipped][:, [1, 0, 2, 3]]
    return points, cells


def box(sides, divisions) -> tuple[np.ndarray, np.ndarray]:
    """Return a box from the origin to ``sides``, cut into ``divisions`` bricks of six tetrahedra each."""
    from skfem import MeshTet

    axes = [np.linspace(0, side, n + 1) for side, n in zip(sides, divisions, strict=True)]
    mesh = MeshTet.init_tensor(*axes)
    return oriented(mesh.p.T.copy(), mesh.t.T.copy())


def distorted_box(sides, divisions, by: float, random) -> tuple[np.ndarray, np.ndarray]:
    """Return a :func:`box` whose inner points are moved by up to ``by``, so that no element is like another."""
    points, cells = box(sides, divisions)
    inner = ((points > 1e-9) & (points < np.array(sides) - 1e-9)).all(axis=1)
    points[inner] += by * random.uniform(-1, 1, (inner.sum(), 3))
    return points, cells


def ball(radius: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a ball meshed by gmsh with elements of about ``size``, blown up to the true ball's volume.

    Flat facets inscribe the sphere; at equal volume their effect on the frequencies is of second order.
    """
    import gmsh

    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setNumber("Mesh.MeshSizeMin", size)
        gmsh.model.occ.addSphere(0, 0, 0, radius)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(3)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, cells = gmsh.model.mesh.getElementsByType(4)
    finally:
        gmsh.finalize()
    order = np.argsort(tags)
    points = coordinates.reshape(-1, 3)[order]
    cells = np.searchsorted(tags[order], cells).reshape(-1, 4)
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = oriented(points[used], cells.reshape(-1, 4))
    edges = points[cells][:, 1:] - points[cells][:, :1]
    volume = np.linalg.det(edges).sum() / 6
    return points * (4 / 3 * np.pi * radius**3 / volume) ** (1 / 3), cells
