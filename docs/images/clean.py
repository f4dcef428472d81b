"""Draw `clean-ladder.png`: bodies broken on purpose, and what the ladder of repairs makes of them.

python docs/images/clean.py
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from pictures import save_sheet, shot, triangles
from PIL import Image
from trimesh.creation import capsule, cylinder

from vibraverse.files import meshes
from vibraverse.geometry import surfaces
from vibraverse.geometry.cleaning.clean import clean

OUT = Path(__file__).with_name("clean-ladder.png")
SIZE = 300
FRONT, BACK = "#cfc6b4", "#b8402f"


def bundled(name: str):
    """Return a model that comes with pyvista."""
    folder = Path(find_spec("pyvista").submodule_search_locations[0]) / "examples"
    mesh = meshes.read_mesh(folder / name)
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


def drawn(vertices, faces, towards) -> Image.Image:
    """Return a picture; faces seen from behind are red."""
    options = {"color": FRONT, "backface_params": {"color": BACK}}
    return shot((triangles(vertices, faces), options), towards=towards, size=SIZE, zoom=1.05)


def main() -> None:
    """Draw each body: the source, the result, and how it came about."""
    cases = [
        (punched(), (2, -2.4, 1.8)),
        (crossing(), (2, -2.4, 1.8)),
        (bundled("airplane.ply"), (-1.5, -2.0, 1.6)),
        (cloth(), (2, -2.4, 1.8)),
    ]
    panels = []
    for (vertices, faces), towards in cases:
        body = clean(vertices, faces, open_sheets="thicken", sheet_thickness=0.04)
        source = drawn((vertices - body.centre) * body.scale, faces, towards)
        result = drawn(body.vertices, body.faces, towards)
        panels.append((f"{body.rung}: {'; '.join(body.repairs)}", [source, result]))
    save_sheet(OUT, panels, columns=2, colours=128)


if __name__ == "__main__":
    main()
