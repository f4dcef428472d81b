"""Unions and differences of closed surfaces, on one thread of ``manifold3d``."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold, Mesh64, OpType

from vibraverse.sources.profiles import Surface


def solid(surface: Surface) -> Manifold:
    """Return the solid inside a closed, oriented, manifold surface; ``ValueError`` when it is not one."""
    vertices, faces = surface
    made = Manifold(
        Mesh64(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64))
    )
    if made.is_empty():
        raise ValueError(f"the surface bounds no solid: {made.status().name}")
    return made


def place(part: Manifold, x=0.0, y=0.0, z=0.0, turn_x=0.0, turn_y=0.0, turn_z=0.0) -> Manifold:
    """Turn a solid about the axes (degrees, x first), then move it."""
    return part.rotate([turn_x, turn_y, turn_z]).translate([x, y, z])


def union(*parts: Manifold) -> Manifold:
    """Return the union of overlapping solids."""
    return Manifold.batch_boolean(list(parts), OpType.Add)


def evened(joined: Manifold, spacing: float) -> Manifold:
    """Remove the slivers along the seams of a union and split edges longer than ``spacing``."""
    return joined.simplify(0.02 * spacing).refine_to_length(spacing)
