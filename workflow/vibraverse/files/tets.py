"""Tetrahedral meshes as gmsh files, through meshio."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def write_tets(path: str | Path, points: np.ndarray, cells: np.ndarray) -> None:
    """Write points (N, 3) and tetrahedra (T, 4) to a binary gmsh 4.1 file."""
    import meshio

    mesh = meshio.Mesh(points, [("tetra", np.asarray(cells, dtype=np.int64))])
    meshio.write(path, mesh, file_format="gmsh", binary=True)


def read_tets(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Read points (N, 3) float64 and tetrahedra (T, 4) int64 of a gmsh file."""
    import meshio

    mesh = meshio.gmsh.read(path)
    return mesh.points, np.asarray(mesh.get_cells_type("tetra"), dtype=np.int64)
