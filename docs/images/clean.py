"""Draw `clean-ladder.png`: bodies broken on purpose, and what the ladder of repairs makes of them.

python docs/images/clean.py
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pyvista
from PIL import Image, ImageDraw
from trimesh.creation import capsule, cylinder

from vibraverse import meshfiles
from vibraverse.geometry import surfaces
from vibraverse.geometry.clean import clean

OUT = Path(__file__).with_name("clean-ladder.png")
SIZE, CAPTION = 300, 22
FRONT, BACK = "#cfc6b4", "#b8402f"


def bundled(name: str):
    """Return a model that comes with pyvista."""
    folder = Path(find_spec("pyvista").submodule_search_locations[0]) / "examples"
    mesh = meshfiles.read_mesh(folder / name)
    return mesh.vertices, mesh.faces


def punched():
    """Return the nut with holes in it."""
    vertices, faces = bundled("nut.ply")
    lost = np.random.default_rng(4).choice(len(faces), 40, replace=False)
    return vertices, np.delete(faces, lost, axis=0)


def crossing():
    """Return open tubes and a capsule that run through one another, some inside out."""
    tubes = []
    for k in range(3):
        tube = cylinder(radius=0.28, height=2.4, sections=40)
        flat = np.abs(tube.face_normals[:, 2]) < 0.5
        points = np.roll(np.array(tube.vertices), k, axis=1)
        tubes.append((points, np.array(tube.faces)[flat][:, :: (1, -1, 1)[k]]))
    ball = capsule(height=0.2, radius=0.6, count=[24, 24])
    return surfaces.joined([*tubes, (np.array(ball.vertices), np.array(ball.faces))])


def cloth():
    """Return a sheet with waves."""
    n = 40
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    vertices = np.stack([x, y, 0.18 * np.sin(4 * x) * np.cos(3 * y)], axis=-1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return vertices, np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + 1, i + n, i + n + 1], 1)])


def shot(vertices, faces, towards) -> Image.Image:
    """Return a picture; faces seen from behind are red."""
    plotter = pyvista.Plotter(off_screen=True, window_size=(2 * SIZE, 2 * SIZE))
    surface = pyvista.PolyData(vertices, np.hstack([np.full((len(faces), 1), 3), faces]))
    plotter.add_mesh(surface, color=FRONT, backface_params={"color": BACK})
    plotter.camera_position = [towards, (0, 0, 0), (0, 0, 1)]
    plotter.reset_camera()
    plotter.camera.zoom(1.05)
    picture = Image.fromarray(plotter.screenshot(return_img=True))
    plotter.close()
    return picture.resize((SIZE, SIZE), Image.Resampling.LANCZOS)


def main() -> None:
    """Draw one row per body: the source, the result, and how it came about."""
    cases = [
        (punched(), (2, -2.4, 1.8)),
        (crossing(), (2, -2.4, 1.8)),
        (bundled("airplane.ply"), (-1.5, -2.0, 1.6)),
        (cloth(), (2, -2.4, 1.8)),
    ]
    columns = 2
    sheet = Image.new("RGB", (2 * columns * SIZE, (SIZE + CAPTION) * -(-len(cases) // columns)), "white")
    write = ImageDraw.Draw(sheet)
    for k, (source, towards) in enumerate(cases):
        body = clean(*source, open_sheets="thicken", sheet_thickness=0.04)
        x, y = 2 * SIZE * (k % columns), (SIZE + CAPTION) * (k // columns)
        sheet.paste(shot((source[0] - body.centre) * body.scale, source[1], towards), (x, y + CAPTION))
        sheet.paste(shot(body.vertices, body.faces, towards), (x + SIZE, y + CAPTION))
        write.text((x + 8, y + 6), f"{body.rung}: {'; '.join(body.repairs)}", fill="black")
    sheet.quantize(128, dither=Image.Dither.NONE).save(OUT, optimize=True)
    print(f"{OUT}: {OUT.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
