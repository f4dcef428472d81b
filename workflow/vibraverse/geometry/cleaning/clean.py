"""From a triangle soup to the surface of one solid body, by the gentlest repair that suffices.

The soup is moved and scaled and climbs the ladder (:mod:`vibraverse.geometry.cleaning.ladder`). Then the result is
moved and scaled: its bounding box is centred at the origin and its longest side is 1.8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry import LONGEST_SIDE, Mesh, repair, surfaces
from vibraverse.geometry.cleaning.judge import Sheet, Unfit, counted, judge
from vibraverse.geometry.cleaning.ladder import GENTLE_RUNGS, RUNGS, SEVERE_RUNGS, SHEET_RUNGS, Climb, climb
from vibraverse.geometry.cleaning.sifting import Sifted, sift
from vibraverse.geometry.distance.deviation import EXACT, Deviation, deviation

#: Surfaces with more faces than this are simplified. The tolerances bound the motion of the surface, in normalised
#: units, and the relative change of volume.
_DENSE_FACES = 100_000
_SIMPLIFY_TOLERANCE, _MAX_VOLUME_CHANGE = 3e-4, 1e-3
#: Points are flat along a principal axis if their extent is below this share of the largest one.
_FLAT_SHARE = 1e-6
_NOTHING_BESIDE = Sifted((np.zeros((0, 3)), np.zeros((0, 3), np.int64)))


@dataclass(frozen=True)
class CleanSurface:
    """A solid body's surface in normalised coordinates, and the repairs behind it.

    ``normalised = (source - centre) * scale``; ``longest_side`` is in source units.
    """

    vertices: np.ndarray
    faces: np.ndarray
    rung: str
    """The repair that sufficed."""
    ladder: list[dict[str, str]]
    """The gentler repairs and why each failed: ``{"rung": …, "failed": …}``."""
    repairs: list[str]
    """Descriptions of the changes."""
    dropped_parts: int
    """Number of separate bodies that were dropped."""
    dropped_share: float
    """Their share of the volume."""
    left_out_parts: int
    """Number of open and flat parts beside the body that enclose nothing and were left out."""
    left_out_share: float
    """Their share of the source's area."""
    joined_bodies: int
    """Number of separate bodies that a wrap joined; 0 if it joined none."""
    joined_growth: float
    """Relative change of their volume."""
    filled_cavities: int
    """Number of inner shells that were filled."""
    deviation: Deviation
    """Distances between the surface and the source's."""
    volume_change: float | None
    """Relative change; None if the source's surface bounds no volume."""
    area_change: float
    """Relative change."""
    centre: np.ndarray
    scale: float
    longest_side: float


def clean(
    vertices: np.ndarray,
    faces: np.ndarray,
    max_triangles: int = 2_000_000,
    max_dropped: float = 0.5,
    max_joined: float = 0.25,
    open_sheets: str = "refuse",
    sheet_thickness: float = 0.02,
) -> CleanSurface:
    """Return the surface of the one solid body that a soup of triangles describes.

    ``vertices`` (V, 3) finite, ``faces`` (F, 3). The largest of several separate bodies is kept if the others hold at
    most ``max_dropped`` of the volume. Bodies with small gaps between them are joined if that changes their volume by
    at most the share ``max_joined``. ``open_sheets`` is ``"refuse"`` or ``"thicken"``, to ``sheet_thickness`` times the
    longest side. Raises :class:`Refused` with reason ``too_large``, ``empty``, ``not_a_solid``, ``separate_bodies`` or
    ``not_repairable``.
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
    centre, scale = _frame(vertices)
    soup = (vertices - centre) * scale, repair.drop_doubles(faces)
    failed: list[dict[str, str]] = []
    limits = {"max_dropped": max_dropped, "max_joined": max_joined}
    found, beside = _climbed(soup, failed, limits, open_sheets, sheet_thickness * LONGEST_SIDE)
    body, thinned = _thin_out(*found.body)
    away = found.deviation or EXACT
    if thinned:
        away = deviation(found.soup, body, found.attempt.dropped)
    source_volume = _enclosed(*found.soup)
    # One transformation from source coordinates: a mesh that needed no repair is exactly the source, moved and scaled.
    shift, factor = _frame(body[0])
    return CleanSurface(
        vertices=(body[0] - shift) * factor,
        faces=body[1],
        rung=found.rung,
        ladder=failed,
        repairs=_left_out(beside) + found.attempt.notes + thinned,
        dropped_parts=len(found.attempt.dropped),
        dropped_share=found.attempt.dropped_share,
        left_out_parts=beside.parts,
        left_out_share=beside.area_share,
        joined_bodies=found.attempt.joined,
        joined_growth=found.attempt.joined_growth,
        filled_cavities=found.attempt.filled_cavities,
        deviation=away,
        volume_change=surfaces.volume(*body) / source_volume - 1 if source_volume else None,
        area_change=surfaces.area(*body) / surfaces.area(*soup) - 1,
        centre=centre + shift / scale,
        scale=scale * factor,
        longest_side=LONGEST_SIDE / (scale * factor),
    )


def _climbed(
    soup: Mesh, failed: list[dict[str, str]], limits: dict[str, float], open_sheets: str, thickness: float
) -> tuple[Climb, Sifted]:
    """Climb the ladder; return its end, and what was left out beside the bodies.

    An open sheet is refused, or climbs the ladder for sheets. Failures are appended to ``failed``.
    """
    try:
        return _solid(soup, failed, limits)
    except Sheet as sheet:
        if open_sheets != "thicken":
            raise Refused(
                "not_a_solid",
                f"The mesh is an open sheet: {sheet}.",
                "Give it a thickness in the program that made it, or set clean.open_sheets to thicken.",
            ) from None
    except Unfit as unfit:
        raise _refused(unfit, failed) from None
    try:
        return climb(SHEET_RUNGS, soup, failed, {}, thickness=thickness, **limits), _NOTHING_BESIDE
    except Unfit as unfit:
        raise _refused(unfit, failed) from None


def _solid(soup: Mesh, failed: list[dict[str, str]], limits: dict[str, float]) -> tuple[Climb, Sifted]:
    """Climb the ladder for solids; raises :class:`Sheet` if nothing encloses anything, :class:`Unfit` at its end."""
    if _is_flat(soup[0]):
        failed.append({"rung": RUNGS[0][0], "failed": "no volume"})
        raise Sheet("all its points lie in one plane")
    cache: dict = {}
    try:
        return climb(GENTLE_RUNGS, soup, failed, cache, **limits), _NOTHING_BESIDE
    except Unfit:
        beside = sift(*soup)
    encloses = len(beside.bodies[1]) > 0
    if encloses and beside.parts and not beside.together:
        return climb(RUNGS, beside.bodies, failed, {}, True, **limits), beside
    try:
        return climb(SEVERE_RUNGS, soup, failed, cache, encloses, **limits), _NOTHING_BESIDE
    except Unfit:
        beside = sift(*soup, holes=True)
        if encloses or not len(beside.bodies[1]) or not beside.parts or beside.together:
            raise
    return climb(RUNGS, beside.bodies, failed, {}, True, **limits), beside


def _refused(unfit: Unfit, failed: list[dict[str, str]]) -> Refused:
    """Return the refusal at the end of the ladder, with why each rung failed."""
    said = "; ".join(f"{entry['rung']}: {entry['failed']}" for entry in failed)
    return Refused(unfit.reason, f"No repair made the surface that of one solid. {said}.", unfit.advice)


def _left_out(beside: Sifted) -> list[str]:
    """Return the note about parts that were left out beside the body."""
    if not beside.parts:
        return []
    share = f"{100 * beside.area_share:.2g} % of the area"
    return [f"left out {counted(beside.parts, 'open or flat part')} with {share}"]


def _enclosed(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume that a soup encloses; 0 if it is not closed or its faces disagree."""
    found = surfaces.topology(faces, len(vertices))
    if found.open_edges or found.crowded_edges or found.disagreeing_edges:
        return 0.0
    return abs(surfaces.volume(vertices, faces))


def _frame(vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """Return centre and scale of the normalised frame."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return (low + high) / 2, LONGEST_SIDE / float((high - low).max())


def _is_flat(vertices: np.ndarray) -> bool:
    """Return whether all points lie in one plane; raises :class:`Refused` if they lie on one line."""
    centred = vertices - vertices.mean(axis=0)
    extents = np.linalg.svd(centred.T @ centred, compute_uv=False) ** 0.5
    if extents[1] < _FLAT_SHARE * extents[0]:
        raise Refused("not_a_solid", "All points of the mesh lie on one line.", "Export the mesh again.")
    return bool(extents[2] < _FLAT_SHARE * extents[0])


def _thin_out(vertices: np.ndarray, faces: np.ndarray) -> tuple[Mesh, list[str]]:
    """Simplify a very dense surface if that keeps its volume and its validity; return it with notes."""
    if len(faces) <= _DENSE_FACES:
        return (vertices, faces), []
    thinner = repair.simplify(vertices, faces, _SIMPLIFY_TOLERANCE)
    try:
        judge(*thinner)
    except Unfit:
        return (vertices, faces), []
    change = surfaces.volume(*thinner) / surfaces.volume(vertices, faces) - 1
    if abs(change) > _MAX_VOLUME_CHANGE:
        return (vertices, faces), []
    return thinner, [f"thinned {counted(len(faces), 'triangle')} to {len(thinner[1])}"]
