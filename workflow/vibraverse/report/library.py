"""The library with which the page shows models, as ``envs/front.py`` bundles it into the environment."""

from __future__ import annotations

import sys
from pathlib import Path

#: The page's own scripts for an object, in the order in which they are loaded, after the library.
SCRIPTS = (
    "data.js",
    "route.js",
    "unpack.js",
    "synth.js",
    "points.js",
    "words.js",
    "elements.js",
    "wav.js",
    "sound.js",
    "scene.js",
    "spectrum.js",
    "spectrogram.js",
    "controls.js",
    "places.js",
    "still.js",
    "struck.js",
    "share.js",
    "tools.js",
    "about.js",
    "object.js",
)


def bundle(prefix: str | Path = sys.prefix) -> str | None:
    """Return the bundled library; None where it could not be fetched: then pages show pictures."""
    path = Path(prefix, "share/vibraverse/three.js")
    return path.read_text(encoding="utf-8") if path.is_file() else None
