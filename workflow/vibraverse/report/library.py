"""What ``envs/front.py`` made in the environment: the library with which the page shows models, and small scripts."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from vibraverse.report import shell

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


#: The environment.
PREFIX = Path(sys.prefix)


def bundle() -> str | None:
    """Return the bundled library; None where it could not be fetched: then pages show pictures."""
    path = PREFIX / "share/vibraverse/three.js"
    return path.read_text(encoding="utf-8") if path.is_file() else None


def small(name: str) -> str:
    """Return a script or style of this room without what machines do not need; as it is written where nobody made that.

    What was made from another text has another name.
    """
    text = shell.text(name)
    made = hashlib.sha256(text.encode()).hexdigest() + Path(name).suffix
    path = PREFIX / "share/vibraverse/page" / made
    return path.read_text(encoding="utf-8") if path.is_file() else text
