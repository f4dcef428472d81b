"""Draw `tets.png`: a surface as it came, and cut open the elements of the solid and of the hollow body.

python docs/images/tets.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista
from pictures import save_sheet, shot, triangles
from PIL import Image

from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.grids import Sampler
from vibraverse.geometry.hollow import hollow
from vibraverse.geometry.meshing.tets import tetrahedralise
from vibraverse.sources.families import generate

OUT = Path(__file__).with_name("tets.png")
SIZE = 420
OUTSIDE, INSIDE = "#cfc6b4", "#7d9bb0"
TETRAHEDRON = 10
TOWARDS = (0.5, -2.6, 1.1)


def drawn(*meshes) -> Image.Image:
    """Return a picture of meshes, each with its colour."""
    lines = {"show_edges": True, "line_width": 1.0, "edge_color": "#4a4640"}
    return shot(
        *((mesh, {"color": colour, **lines}) for mesh, colour in meshes), towards=TOWARDS, size=SIZE, zoom=1.3
    )


def opened(mesh) -> Image.Image:
    """Return a picture of the elements whose middle lies behind a plane through the axis; those inside in blue."""
    grid = pyvista.UnstructuredGrid(
        np.hstack([np.full((len(mesh.cells), 1), 4), mesh.cells]),
        np.full(len(mesh.cells), TETRAHEDRON),
        mesh.points,
    )
    behind = grid.extract_cells(np.flatnonzero(mesh.points[mesh.cells].mean(axis=1)[:, 1] > 0))
    whole = grid.extract_surface(algorithm="dataset_surface")
    shown = behind.extract_surface(algorithm="dataset_surface")
    on_body = shown.cell_centers().points
    distance = np.abs(pyvista.PolyData(on_body).compute_implicit_distance(whole)["implicit_distance"])
    outside = distance < 1e-6
    return drawn((shown.extract_cells(outside), OUTSIDE), (shown.extract_cells(~outside), INSIDE))


def main() -> None:
    """Draw the three pictures side by side."""
    made = generate("bell-0000")
    body = clean(made.vertices, made.faces)
    surface = body.vertices, body.faces
    inside = hollow(*surface, Sampler(*surface).signed_distance(128), 0.4)
    solid, shell = tetrahedralise(*surface), tetrahedralise(inside.vertices, inside.faces)
    panels = [
        (f"as it came: {len(surface[1])} triangles", [drawn((triangles(*surface), OUTSIDE))]),
        (f"solid: {len(solid.cells)} elements", [opened(solid)]),
        (f"hollow: {len(shell.cells)} elements", [opened(shell)]),
    ]
    save_sheet(OUT, panels, columns=len(panels), colours=64)


if __name__ == "__main__":
    main()
