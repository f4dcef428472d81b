"""Subtraction of closed meshes from closed meshes."""

from __future__ import annotations

import numpy as np

from vibraverse.files.reading.mistakes import Unsupported
from vibraverse.geometry import Mesh


def subtract(mesh: Mesh, cutters: list[Mesh]) -> Mesh:
    """Return a mesh (V, 3), (F, 3) without what is inside the cutters; raises :class:`Unsupported` unless all close."""
    import manifold3d

    solids = []
    for points, triangles in (mesh, *cutters):
        points, inverse = np.unique(points, axis=0, return_inverse=True)
        a, b, c = corners = inverse.ravel()[triangles].T
        corners = corners.T[(a != b) & (b != c) & (c != a)]
        solid = manifold3d.Manifold(
            manifold3d.Mesh64(np.ascontiguousarray(points), corners.astype(np.uint64))
        )
        if solid.status() != manifold3d.Error.NoError:
            raise Unsupported(
                "it holds a negative volume, which cannot be subtracted, as it or the part around it is not closed",
                "Subtract it in a mesh editor and export the result.",
            )
        solids.append(solid)
    cut = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Subtract).to_mesh64()
    return np.array(cut.vert_properties[:, :3], np.float64), np.array(cut.tri_verts, np.int64)
