"""Mesh cleaning, grids, hollow bodies and tetrahedra: arrays in, arrays out, no file paths."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np

#: Triangles: vertices (V, 3) float64 and faces (F, 3) integers, counter-clockwise seen from outside.
Mesh: TypeAlias = "tuple[np.ndarray, np.ndarray]"

#: Longest side of a cleaned body's bounding box. The box is centred at the origin.
LONGEST_SIDE = 1.8
