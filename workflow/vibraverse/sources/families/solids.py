"""Solids from closed surfaces by union and difference (manifold3d), and the remeshing of their surfaces (Mmg)."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold, Mesh64, OpType
from mmgpy import MmgMeshS

from vibraverse.geometry import Mesh

#: Largest relative change of volume by remeshing; Mmg rounds facets, so even a good surface gains volume.
_MAX_VOLUME_CHANGE = 0.03


def solid(surface: Mesh) -> Manifold:
    """Return the solid inside a closed, oriented, manifold surface; raises ``ValueError`` for others."""
    vertices, faces = surface
    made = Manifold(
        Mesh64(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.uint64))
    )
    if made.is_empty():
        raise ValueError(f"the surface bounds no solid: {made.status().name}")
    return made


def place(part: Manifold, x=0.0, y=0.0, z=0.0, turn_x=0.0, turn_y=0.0, turn_z=0.0) -> Manifold:
    """Rotate a solid about the axes (degrees, x first), then move it."""
    return part.rotate([turn_x, turn_y, turn_z]).translate([x, y, z])


def union(*parts: Manifold) -> Manifold:
    """Return the union of overlapping solids."""
    return Manifold.batch_boolean(list(parts), OpType.Add)


def evened(joined: Manifold, spacing: float) -> Mesh:
    """Return the surface of a solid with near-equilateral triangles of about ``spacing``.

    Unions leave slivers along their seams. Mmg remeshes the surface and keeps edges of more than 30 degrees sharp. If
    that changes the volume or the genus, the original surface is returned with long edges split.
    """
    surface = remeshed(joined, spacing)
    return surface if surface is not None else arrays(joined.refine_to_length(spacing))


def remeshed(joined: Manifold, spacing: float, ridge_deg: float = 30.0) -> Mesh | None:
    """Return the surface of a solid, remeshed by Mmg with triangles of about ``spacing``.

    Edges of more than ``ridge_deg`` degrees stay sharp. Return None if Mmg fails, or changes the volume or the
    genus.
    """
    vertices, faces = arrays(joined)
    mesh = MmgMeshS(np.ascontiguousarray(vertices), faces.astype(np.int32))
    size = {"hmax": spacing, "hmin": 0.35 * spacing, "hausd": 0.05 * spacing, "hgrad": 1.5}
    try:
        mesh.remesh(**size, ar=ridge_deg, verbose=-1)
    except RuntimeError:  # Mmg gives up on some surfaces
        return None
    surface = mesh.get_vertices().copy(), mesh.get_triangles().astype(np.int64)
    result = Manifold(Mesh64(np.ascontiguousarray(surface[0]), surface[1].astype(np.uint64)))
    same = abs(result.volume() / joined.volume() - 1.0) < _MAX_VOLUME_CHANGE
    return surface if same and result.genus() == joined.genus() else None


def arrays(joined: Manifold) -> Mesh:
    """Return vertices (V, 3) and faces (F, 3) of a solid."""
    mesh = joined.to_mesh64()
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)
