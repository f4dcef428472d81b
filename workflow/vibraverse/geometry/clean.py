"""From a triangle soup to the surface of one solid body, by the gentlest repair that suffices.

The ladder is a list of rungs, from welding equal points to wrapping the whole soup. Each rung starts from the
welded soup; the first whose result passes :func:`judge` is taken: closed, oriented outward, manifold in edges
and vertices, one connected part, free of self-intersections, with a positive volume. The result is moved and
scaled so that its bounding box is centred at the origin and its longest side is 1.8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.remesh import move
from vibraverse.geometry.sight import LineOfSight
from vibraverse.refusal import Refused

#: Longest side of a cleaned body's bounding box.
LONGEST_SIDE = 1.8
#: Welding distance of the second rung, in normalised units.
_WELD = 1e-5
#: Self-intersections are patched up to this share of the faces.
_MAX_PATCHED = 0.05
#: Pieces that a repair leaves apart may hold at most this share of the volume and are then dropped.
_MAX_DROPPED = 0.002
#: Wrapping radii and distances from the soup, as shares of the diagonal, finest first.
_WRAPS = ((0.01, 0.003), (0.02, 0.003), (0.04, 0.004))
#: A wrap that holds less than this share of a coarser one has entered the body through a hole.
_ENTERED = 0.5
#: How often a wrap is drawn in again after leaving out where it would cut itself.
_DRAW_ROUNDS = 8
#: A repair may change the sides of the bounding box by this much.
_MAX_EXTENT_CHANGE = 0.02
#: A wrap whose mean thickness 2V/A is below this many distances from the soup has nothing inside it.
_SHEET = 3.0
#: More faces than this are thinned, where that moves the surface by no more than the first number and changes the
#: volume by no more than the second as a share.
_DENSE = 100_000
_MOVED, _HARMLESS = 3e-4, 1e-3
#: Holes whose covers are larger than this share of a part's own area are openings, not holes.
_MAX_COVER = 0.45


@dataclass(frozen=True)
class CleanSurface:
    """A solid body's surface in normalised coordinates and what it took to get there.

    ``normalised = (source - centre) * scale``; ``longest_side`` is in source units.
    """

    vertices: np.ndarray
    faces: np.ndarray
    rung: str
    repairs: list[str]
    centre: np.ndarray
    scale: float
    longest_side: float


class Unfit(Exception):
    """Says why a rung's result is not the surface of a solid."""


def clean(vertices: np.ndarray, faces: np.ndarray, max_triangles: int = 2_000_000) -> CleanSurface:
    """Return the surface of the one solid body that a soup of triangles describes.

    ``vertices`` (V, 3) finite, ``faces`` (F, 3). Raises :class:`Refused` with reason ``too_large``, ``empty``,
    ``not_a_solid`` or ``not_repairable``.
    """
    if len(faces) > max_triangles:
        raise Refused(
            "too_large",
            f"The mesh has {len(faces)} triangles; the limit is {max_triangles}.",
            "Simplify it, or raise clean.max_triangles.",
        )
    vertices, faces = repair.weld(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64))
    if not len(faces):
        raise Refused("empty", "Every triangle of the mesh uses one point twice.", "Export the mesh again.")
    _require_extent(vertices)
    centre, scale = _frame(vertices)
    soup = (vertices - centre) * scale
    rung, body, notes = _climb(soup, repair.drop_doubles(faces))
    body, thinned = _thin_out(*body)
    # The frame of the result is applied to the source's coordinates in one step, so that what needed no
    # repair is exactly the source, moved and scaled.
    shift, factor = _frame(body[0])
    return CleanSurface(
        vertices=(body[0] - shift) * factor,
        faces=body[1],
        rung=rung,
        repairs=notes + thinned,
        centre=centre + shift / scale,
        scale=scale * factor,
        longest_side=LONGEST_SIDE / (scale * factor),
    )


def judge(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raise :class:`Unfit` unless the surface bounds one solid body."""
    if not len(faces):
        raise Unfit("nothing is left")
    found = surfaces.topology(faces, len(vertices))
    for count, what in (
        (found.open_edges, "open edges"),
        (found.crowded_edges, "edges with more than two faces"),
        (found.disagreeing_edges, "edges between faces of opposite orientation"),
        (found.pinched_vertices, "points where the surface touches itself"),
        (found.components - 1, "further parts"),
    ):
        if count:
            raise Unfit(f"{count} {what}")
    enclosed = surfaces.volume(vertices, faces)
    if enclosed <= 0:
        raise Unfit("no volume")
    crossing = int(repair.crossing_faces(vertices, faces).sum())
    if crossing:
        raise Unfit(f"{crossing} faces that cut each other")


def _as_it_is(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> repair.Mesh:
    """Keep every triangle; turn those that point the wrong way."""
    turned = repair.orient(vertices, faces)
    count = int((turned != faces).any(axis=1).sum())
    if count:
        notes.append(f"turned {count} triangles")
    return vertices, turned


def _weld(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> repair.Mesh:
    """Join points that are almost equal."""
    joined, kept = repair.weld(vertices, faces, _WELD)
    kept = repair.drop_doubles(kept)
    if len(kept) < len(faces) or len(joined) < len(vertices):
        notes.append(
            f"joined {len(vertices) - len(joined)} points, dropped {len(faces) - len(kept)} triangles"
        )
    return _as_it_is(joined, kept, notes)


def _patch(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> repair.Mesh:
    """Replace the neighbourhood of triangles that cut each other."""
    welded = _weld(vertices, faces, notes)
    found = surfaces.topology(welded[1], len(welded[0]))
    if found.open_edges:
        raise Unfit(f"{found.open_edges} open edges")
    crossing = int(repair.crossing_faces(*welded).sum())
    if crossing > _MAX_PATCHED * len(welded[1]):
        raise Unfit(f"{crossing} faces that cut each other")
    vertices, faces = repair.patch(*welded)
    notes.append(f"replaced {crossing} triangles that cut each other")
    return vertices, repair.orient(vertices, faces)


def _pieces(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> list[repair.Mesh]:
    """Close the holes of every part and join the parts; return what then lies apart."""
    bodies, closed = [], 0
    for part in repair.parts(*_weld(vertices, faces, notes)):
        if not surfaces.topology(part[1], len(part[0])).closed_manifold:
            open_area = surfaces.area(*part)
            part = repair.close_holes(*part)
            cover = surfaces.area(*part) / open_area - 1
            if cover > _MAX_COVER:
                raise Unfit(f"a part of which {100 * cover / (1 + cover):.0f} % would be made up")
            closed += 1
        part = part[0], repair.orient(*part)
        crossing = int(repair.crossing_faces(*part).sum())
        if crossing > _MAX_PATCHED * len(part[1]):
            raise Unfit(f"{crossing} faces that cut each other")
        if crossing:
            part = repair.patch(*part)
        bodies.append(part)
    try:
        pieces = repair.join(bodies, _WELD)
    except ValueError as error:
        raise Unfit(f"a part is not closed ({error})") from None
    if closed:
        notes.append(f"closed the holes of {closed} of {len(bodies)} parts")
    if len(bodies) > 1:
        notes.append(f"joined {len(bodies)} parts, which left {len(pieces)}")
    return pieces


def _join(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> repair.Mesh:
    """Close the holes of every part and join the parts into one body."""
    return _largest(_pieces(vertices, faces, notes), notes)


def _largest_part(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> repair.Mesh:
    """Of parts that lie apart keep the largest."""
    return _largest(_pieces(vertices, faces, notes), notes, max_dropped=1.0)


def _wrap(vertices: np.ndarray, faces: np.ndarray, notes: list[str]) -> repair.Mesh:
    """Shrink-wrap everything, as finely as the holes allow."""
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    enclosed = 0.0
    best: tuple | None = None
    for alpha, offset in reversed(_WRAPS):
        said: list[str] = []
        try:
            wrapped = repair.wrap(vertices, faces, alpha, offset)
            wrapped = _largest([(v, repair.orient(v, f)) for v, f in repair.parts(*wrapped)], said)
            inside = surfaces.volume(*wrapped)
            if inside < _ENTERED * enclosed:
                break
            judge(*wrapped)
            wrapped = _drawn_in(*wrapped, offset * diagonal)
        except Unfit:
            continue
        enclosed = max(enclosed, inside)
        thickness = 2 * surfaces.volume(*wrapped) / surfaces.area(*wrapped) / (offset * diagonal)
        best = wrapped, thickness, [f"wrapped at {100 * alpha:g} % of the diagonal", *said]
    if best is None:
        raise Unfit("wrapping left it in pieces")
    wrapped, thickness, said = best
    if thickness < _SHEET:
        raise Refused(
            "not_a_solid",
            "The surface is an open sheet: closing it gives a body of almost no thickness.",
            "Give it a thickness in the program that made it.",
        )
    notes += said
    return wrapped


def _drawn_in(points: np.ndarray, triangles: np.ndarray, distance: float) -> repair.Mesh:
    """Return a wrap moved back by its ``distance`` from the soup, where the body is thick enough for it.

    What is thinner than twice the distance stays that thick, so that sheets become plates that can be meshed.
    """
    normals = surfaces.vertex_normals(points, triangles)
    room = 0.5 * _thickness(points, triangles, normals, 6 * distance) - distance
    step = -np.clip(room, 0.0, distance)[:, None] * normals
    for _ in range(_DRAW_ROUNDS):
        drawn = move(points, step, triangles)
        crossing = repair.crossing_faces(drawn, triangles)
        if not crossing.any():
            return drawn, triangles
        step[np.unique(triangles[crossing])] = 0.0
    return points, triangles


def _thickness(points: np.ndarray, triangles: np.ndarray, normals: np.ndarray, most: float) -> np.ndarray:
    """Return how thick the body is below every vertex (V,), up to ``most``: the least around each vertex."""
    starts = points - 1e-3 * most * normals
    across = most * LineOfSight(points, triangles).first_hit(starts, starts - most * normals)
    for _ in range(2):
        least = across[triangles].min(axis=1)
        np.minimum.at(across, triangles.ravel(), np.repeat(least, 3))
    return across


#: The ladder, gentlest first: name -> function of the soup that notes what it did and may raise Unfit.
RUNGS: tuple[tuple[str, Callable], ...] = (
    ("as-is", _as_it_is),
    ("weld", _weld),
    ("patch", _patch),
    ("join", _join),
    ("wrap", _wrap),
    ("largest", _largest_part),
)


def _climb(vertices: np.ndarray, faces: np.ndarray) -> tuple[str, repair.Mesh, list[str]]:
    """Return the name, the result and the notes of the first rung that gives a solid."""
    complaint = ""
    for name, rung in RUNGS:
        notes: list[str] = []
        try:
            body = rung(vertices, faces, notes)
            judge(*body)
            if name != "largest":
                _require_same_extent(vertices, body[0])
        except Unfit as unfit:
            complaint = str(unfit)
            continue
        return name, body, notes
    raise Refused(
        "not_repairable",
        f"No repair made the surface that of one solid; the last one left {complaint}.",
        "Close its holes and join its parts in a mesh editor.",
    )


def _largest(pieces: list[repair.Mesh], notes: list[str], max_dropped: float = _MAX_DROPPED) -> repair.Mesh:
    """Return the largest piece; raise when the others are more than crumbs."""
    volumes = np.array([abs(surfaces.volume(*piece)) for piece in pieces])
    if not len(volumes):
        raise Unfit("nothing is left")
    keep = int(volumes.argmax())
    rest = float(1 - volumes[keep] / max(volumes.sum(), 1e-300))
    if rest > max_dropped:
        raise Unfit(f"{len(pieces) - 1} further parts with {100 * rest:.0f} % of the volume")
    if len(pieces) > 1:
        notes.append(f"dropped {len(pieces) - 1} pieces with {100 * rest:.2g} % of the volume")
    return pieces[keep]


def _require_same_extent(before: np.ndarray, after: np.ndarray) -> None:
    """Raise when a repair lost, or added, something that sticks out."""
    ends = [np.array([points.min(axis=0), points.max(axis=0)]) for points in (before, after)]
    change = float(np.abs(ends[1] - ends[0]).max())
    if change > _MAX_EXTENT_CHANGE:
        raise Unfit(f"a shape whose bounding box differs by {100 * change / LONGEST_SIDE:.0f} %")


def _frame(vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre and scale of the normalised frame."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return (low + high) / 2, LONGEST_SIDE / float((high - low).max())


def _require_extent(vertices: np.ndarray) -> None:
    """Refuse points that all lie in one plane or on one line."""
    centred = vertices - vertices.mean(axis=0)
    extents = np.linalg.svd(centred.T @ centred, compute_uv=False) ** 0.5
    if extents[0] == 0 or not np.isfinite(extents).all() or extents[2] < 1e-6 * extents[0]:
        raise Refused(
            "not_a_solid",
            "All points of the mesh lie in one plane, so it bounds no volume.",
            "Give it a thickness in the program that made it.",
        )


def _thin_out(vertices: np.ndarray, faces: np.ndarray) -> tuple[repair.Mesh, list[str]]:
    """Thin a very dense surface when that changes neither its volume nor its validity."""
    if len(faces) <= _DENSE:
        return (vertices, faces), []
    thinner = repair.simplify(vertices, faces, _MOVED)
    try:
        judge(*thinner)
    except Unfit:
        return (vertices, faces), []
    change = surfaces.volume(*thinner) / surfaces.volume(vertices, faces) - 1
    if abs(change) > _HARMLESS:
        return (vertices, faces), []
    return thinner, [f"thinned {len(faces)} triangles to {len(thinner[1])}"]
