"""Surfaces and tetrahedra of the bodies, made like those of every object: clean, hollow, tets."""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.grids import Sampler
from vibraverse.geometry.hollow import hollow
from vibraverse.geometry.meshing.tets import TetMesh, tetrahedralise
from vibraverse.geometry.profiles import arc, revolve
from vibraverse.validation.bodies import Body

#: Edge length on curved surfaces as a share of the radius; the facets' error stays far below the elements'.
_FACET_LENGTH = 0.03
#: Cells of the distance grid along each axis, as in the stage ``grids``.
_GRID_CELLS = 128


def surface(body: Body) -> Mesh:
    """Return the surface of a body in metres; facets enclose the true volume, on which the frequencies depend."""
    if body.kind == "box":
        return _box(body.lengths_m)
    radius = body.lengths_m[0]
    if body.kind == "ball":
        vertices, faces = revolve(arc((0.0, 0.0), radius, -90.0, 90.0, 400), _FACET_LENGTH * radius)
        share = (4 / 3 * np.pi * radius**3 / surfaces.volume(vertices, faces)) ** (1 / 3)
        return vertices * share, faces
    z = body.lengths_m[1] / 2
    vertices, faces = revolve(
        np.array([(0.0, -z), (radius, -z), (radius, z), (0.0, z)]), _FACET_LENGTH * radius
    )
    share = np.sqrt(2 * np.pi * radius**2 * z / surfaces.volume(vertices, faces))
    return vertices * [share, share, 1.0], faces


def _box(sides) -> Mesh:
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners * sides, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])


def skin(body: Body) -> tuple[float, Mesh]:
    """Return metres per mesh unit and the surface to fill, with the cavity of a hollow body.

    Raises :class:`vibraverse.contract.errors.Refused` as the stages do.
    """
    cleaned = clean(*surface(body))
    outside = cleaned.vertices, cleaned.faces
    if not body.wall:
        return 1.0 / cleaned.scale, outside
    hollowed = hollow(*outside, Sampler(*outside).signed_distance(_GRID_CELLS), body.wall)
    return 1.0 / cleaned.scale, (hollowed.vertices, hollowed.faces)


def meshes(body: Body) -> tuple[float, list[TetMesh]]:
    """Return metres per mesh unit, and a mesh for each number of elements of a body, coarse to fine.

    Raises :class:`vibraverse.contract.errors.Refused` as the stages do.
    """
    scale_m, filled = skin(body)
    return scale_m, [tetrahedralise(*filled, count) for count in (*body.elements, *body.finer)]
