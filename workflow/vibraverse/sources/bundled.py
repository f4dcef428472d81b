"""The meshes that ship inside the pyvista package: real, imperfect models that need no network.

The package distributes them under its own licence and names no other. They have no scale, so this module states a
plausible size for each.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

from vibraverse.contract.errors import Refused


@dataclass(frozen=True)
class Bundled:
    """A bundled mesh: its file, its subject and its size."""

    file: str
    title: str
    category: str
    size_m: float
    licence: str = "MIT (as part of PyVista)"
    attribution: str = "The PyVista Developers, https://pyvista.org"


#: Object id -> bundled mesh.
BUNDLED = {
    "nut": Bundled("nut.ply", "A heavy nut", "hardware", 0.12),
    "airplane": Bundled("airplane.ply", "A toy airliner", "toy", 0.25),
    "ant": Bundled("ant.ply", "A large ant", "figure", 0.12),
}


def locate(object_: str) -> Path:
    """Return the path of a bundled mesh, without importing the package that holds it.

    Raises :class:`Refused` (``unavailable``) when the package is not installed or lacks the file.
    """
    spec = importlib.util.find_spec("pyvista")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        path = Path(folder) / "examples" / BUNDLED[object_].file
        if path.is_file():
            return path
    raise Refused(
        "unavailable",
        f"The mesh {BUNDLED[object_].file} is missing: it ships inside the Python package pyvista.",
        "Install pyvista, or take the name out of sources.bundled.",
    )
