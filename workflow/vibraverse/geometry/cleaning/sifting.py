"""Parts of a soup that enclose a volume, told from open and flat parts beside them: a ground plane, a stray triangle.

A part that encloses nothing is left out only beside bodies, and only if such parts enclose nothing together either: six
loose squares may be the sides of a box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.geometry import Mesh, repair, surfaces

#: Points closer than this are joined before parts are told apart; in normalised units.
WELD_DISTANCE = 1e-5
#: A part whose mean thickness 2V/A is below this is flat; in normalised units.
MIN_THICKNESS = 1e-5
#: Largest share of a part's area, once its holes are closed, that their covers may have.
MAX_COVER = 0.3
#: Wrap radius and distance, as shares of the diagonal, that show whether open parts enclose something together, and how
#: many such distances the wrap's mean thickness then has at least. A wrap around a sheet has two.
_WRAP_SIZE, _MIN_WRAP_THICKNESS = (0.04, 0.004), 3.0


@dataclass(frozen=True)
class Sifted:
    """The parts of a soup that enclose a volume, and what lies beside them."""

    bodies: Mesh
    """The faces of parts that enclose a volume; empty without any."""
    parts: int = 0
    """Number of open and flat parts beside them."""
    area_share: float = 0.0
    """Their share of the area."""
    together: bool = False
    """Whether these enclose something together, so that none may be left out."""


def sift(vertices: np.ndarray, faces: np.ndarray, holes: bool = False) -> Sifted:
    """Return the closed parts of a soup apart from the open and flat ones.

    With ``holes`` a part also counts as closed if covers of less than ``MAX_COVER`` close it. Equal points of the soup
    must be merged. If no part is closed, points that are almost equal are merged, too.
    """
    for tolerance in (0.0, WELD_DISTANCE):
        if tolerance:
            vertices, faces = repair.weld(vertices, faces, tolerance)
            faces = repair.drop_doubles(faces)
        label = repair.part_numbers(faces)
        closed = _closed(vertices, faces, label)
        if holes:
            closed = closed | _nearly_closed(vertices, faces, label, closed)
        if closed.any():
            break
    kept = closed[label]
    areas = surfaces.normals_and_areas(vertices, faces)[1]
    open_ = faces[~kept]
    return Sifted(
        surfaces.compact(vertices, faces[kept]),
        int((~closed).sum()),
        float(areas[~kept].sum() / areas.sum()),
        bool(closed.any() and len(open_)) and _encloses(*surfaces.compact(vertices, open_)),
    )


def _closed(vertices: np.ndarray, faces: np.ndarray, label: np.ndarray) -> np.ndarray:
    """Return which parts are closed and not flat; ``label`` (F,) numbers the part of every face."""
    edge, _ = surfaces.edge_numbers(faces)
    of_edge, number = np.unique(np.stack([np.repeat(label, 3), edge], axis=1), axis=0, return_counts=True)
    unsound = np.bincount(of_edge[:, 0], number != 2, minlength=label.max() + 1)
    a, b, c = surfaces.corners(vertices, repair.orient(vertices, faces))
    six_volumes = np.bincount(label, np.einsum("ij,ij->i", a, np.cross(b, c)))
    areas = np.bincount(label, surfaces.normals_and_areas(vertices, faces)[1])
    return (unsound == 0) & (np.abs(six_volumes) / 3 > MIN_THICKNESS * areas)


def _nearly_closed(
    vertices: np.ndarray, faces: np.ndarray, label: np.ndarray, closed: np.ndarray
) -> np.ndarray:
    """Return which open parts small covers close to a body."""
    found = np.zeros_like(closed)
    for part in np.flatnonzero(~closed):
        points, triangles = surfaces.compact(vertices, faces[label == part])
        triangles = repair.orient(points, triangles)
        whole = repair.close_holes(points, triangles)
        area = surfaces.area(*whole)
        found[part] = (
            surfaces.topology(whole[1], len(whole[0])).closed_manifold
            and 2 * abs(surfaces.volume(*whole)) > MIN_THICKNESS * area
            and area - surfaces.area(points, triangles) < MAX_COVER * area
        )
    return found


def _encloses(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Return whether open parts enclose something together: a wrap around them is thicker than one around a sheet."""
    distance = _WRAP_SIZE[1] * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return any(
        2 * surfaces.volume(*shell) > _MIN_WRAP_THICKNESS * distance * surfaces.area(*shell)
        for shell in surfaces.components(*repair.wrap(vertices, faces, *_WRAP_SIZE))
    )
