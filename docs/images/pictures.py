"""What the scripts beside this one share: pictures of meshes, and sheets of pictures with captions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista
from PIL import Image, ImageDraw

CAPTION = 22


def triangles(vertices: np.ndarray, faces: np.ndarray) -> pyvista.PolyData:
    """Return a surface (V, 3), (F, 3) as pyvista holds it."""
    return pyvista.PolyData(vertices, np.hstack([np.full((len(faces), 1), 3), faces]))


def shot(*meshes, towards, size: int, zoom: float) -> Image.Image:
    """Return a picture of meshes, each with the options pyvista draws it with, seen from ``towards``."""
    plotter = pyvista.Plotter(off_screen=True, window_size=(2 * size, 2 * size))
    for mesh, options in meshes:
        plotter.add_mesh(mesh, **options)
    plotter.camera_position = [towards, (0, 0, 0), (0, 0, 1)]
    plotter.reset_camera()
    plotter.camera.zoom(zoom)
    picture = Image.fromarray(plotter.screenshot(return_img=True))
    plotter.close()
    return picture.resize((size, size), Image.Resampling.LANCZOS)


def save_sheet(path: Path, panels: list[tuple[str, list[Image.Image]]], columns: int, colours: int) -> None:
    """Write panels, each pictures of one size side by side under a caption, ``columns`` in a row."""
    size, wide = panels[0][1][0].width, len(panels[0][1])
    sheet = Image.new("RGB", (wide * columns * size, (size + CAPTION) * -(-len(panels) // columns)), "white")
    write = ImageDraw.Draw(sheet)
    for k, (caption, pictures) in enumerate(panels):
        x, y = wide * size * (k % columns), (size + CAPTION) * (k // columns)
        for i, picture in enumerate(pictures):
            sheet.paste(picture, (x + i * size, y + CAPTION))
        write.text((x + 8, y + 6), caption, fill="black")
    sheet.quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB")
