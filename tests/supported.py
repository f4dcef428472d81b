"""Files for the table of what changes geometry, by its rows, and the volume of a mesh."""

from __future__ import annotations

import numpy as np

#: Formats and feature of a row -> function that yields its files: name, content, and what must come of it. That is a
#: volume or a check of the mesh, then perhaps a part of its notes; or parts of a refusal's message and advice.
MAKERS = {}


def row(formats: str, feature: str):
    """Register a function that returns files for a row: name, content and what must come of each."""

    def register(maker):
        MAKERS[formats, feature] = maker
        return maker

    return register


def volume(mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)
