"""Draw `tets.png`: a surface as it came, and cut open the elements of the solid and of the hollow body.

python docs/images/tets.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista
from PIL import Image, ImageDraw

from vibraverse.geometry.clean import clean
from vibraverse.geometry.grids import Sampler
from vibraverse.geometry.hollow import hollow
from vibraverse.geometry.tets import tetrahedralise
from vibraverse.sources.families import generate

OUT = Path(__file__).with_name("tets.png")
SIZE, CAPTION = 420, 22
OUTSIDE, INSIDE = "#cfc6b4", "#7d9bb0"
TETRAHEDRON = 10
TOWARDS = (0.5, -2.6, 1.1)


def shot(*meshes) -> Image.Image:
    """Return a picture of meshes, each with its colour."""
    plotter = pyvista.Plotter(off_screen=True, window_size=(2 * SIZE, 2 * SIZE))
    for mesh, colour in meshes:
        plotter.add_mesh(mesh, color=colour, show_edges=True, line_width=1.0, edge_color="#4a4640")
    plotter.camera_position = [TOWARDS, (0, 0, 0), (0, 0, 1)]
    plotter.reset_camera()
    plotter.camera.zoom(1.3)
    picture = Image.fromarray(plotter.screenshot(return_img=True))
    plotter.close()
    return picture.resize((SIZE, SIZE), Image.Resampling.LANCZOS)


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
    return shot((shown.extract_cells(outside), OUTSIDE), (shown.extract_cells(~outside), INSIDE))


def main() -> None:
    """Draw the three pictures side by side."""
    made = generate("bell-0000")
    body = clean(made.vertices, made.faces)
    surface = body.vertices, body.faces
    inside = hollow(*surface, Sampler(*surface).signed_distance(128), 0.4)
    solid, shell = tetrahedralise(*surface), tetrahedralise(inside.vertices, inside.faces)
    triangles = pyvista.PolyData(surface[0], np.hstack([np.full((len(surface[1]), 1), 3), surface[1]]))
    panels = [
        (f"as it came: {len(surface[1])} triangles", shot((triangles, OUTSIDE))),
        (f"solid: {len(solid.cells)} elements", opened(solid)),
        (f"hollow: {len(shell.cells)} elements", opened(shell)),
    ]
    sheet = Image.new("RGB", (SIZE * len(panels), SIZE + CAPTION), "white")
    write = ImageDraw.Draw(sheet)
    for k, (caption, picture) in enumerate(panels):
        sheet.paste(picture, (SIZE * k, CAPTION))
        write.text((SIZE * k + 8, 6), caption, fill="black")
    sheet.quantize(64, dither=Image.Dither.NONE).save(OUT, optimize=True)
    print(f"{OUT}: {OUT.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
