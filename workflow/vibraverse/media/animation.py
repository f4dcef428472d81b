"""A mode of vibration as a moving picture: a GIF that swings through one period."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from vibraverse.media.images import View, render_poses

#: Where the camera stands.
VIEW = View(25.0, 24.0)
#: Frames of a period, and how long it takes on the screen in seconds: far slower than any body vibrates.
FRAMES, PERIOD_S = 24, 1.2
#: Largest displacement that is shown, as a share of the longest side.
SWING = 0.06
_COLOURS = 128


def poses(vertices: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Return the vertices (V, 3) in a period of a mode with this shape (V, 3), evenly spaced in time: (n, V, 3)."""
    vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    most = np.linalg.norm(shape, axis=1).max()
    share = SWING * np.ptp(vertices, axis=0).max() / most
    phases = np.sin(2 * np.pi * np.arange(FRAMES) / FRAMES)
    return vertices + share * phases[:, None, None] * shape


def gif(vertices: np.ndarray, faces: np.ndarray, shape: np.ndarray, look: str, size_px: int) -> bytes:
    """Return a GIF of a mode of a surface, in the look of a material, that plays on and on."""
    pictures = render_poses(poses(vertices, shape), faces, VIEW, look, size_px)
    frames = [Image.fromarray(picture).quantize(_COLOURS) for picture in pictures]
    file = io.BytesIO()
    duration_ms = round(1000 * PERIOD_S / FRAMES)
    frames[0].save(
        file,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=duration_ms,
        loop=0,
        optimize=False,
    )
    return file.getvalue()
