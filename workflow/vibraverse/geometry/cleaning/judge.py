"""Validity of a surface: whether it bounds one solid body, and if not, why."""

from __future__ import annotations

import numpy as np

from vibraverse.geometry import surfaces
from vibraverse.geometry.distance.crossing import crossing_faces

#: A face has no area beyond rounding if its height is a smaller share of its longest edge.
_FLAT_ASPECT = 1e-14


class Unfit(Exception):
    """The reason why a surface does not bound a solid; ``advice`` and ``reason`` go into the refusal."""

    advice = "Close its holes and join its parts in a mesh editor."
    reason = "not_repairable"


class Sheet(Unfit):
    """The surface is an open sheet: it encloses no volume."""


class Scattered(Unfit):
    """The bodies apart from the largest one hold more volume than may be dropped."""

    advice = "Give each body a file of its own, or raise clean.max_dropped."
    reason = "separate_bodies"


def judge(vertices: np.ndarray, faces: np.ndarray) -> None:
    """Raise :class:`Unfit` unless the surface bounds one solid body.

    Such a surface is closed, oriented outward, connected, and manifold in edges and vertices. Every face has an area,
    and two faces meet only in the edges and points that they share.
    """
    if not len(faces):
        raise Unfit("nothing is left")
    found = surfaces.topology(faces, len(vertices))
    for count, what in (
        (found.open_edges, "open edge"),
        (found.crowded_edges, "edge with more than two faces"),
        (found.disagreeing_edges, "edge between faces of opposite orientation"),
        (found.pinched_vertices, "point where the surface touches itself"),
        (found.components - 1, "further part"),
        (int(without_area(vertices, faces).sum()), "triangle without area"),
    ):
        if count:
            raise Unfit(counted(count, what))
    if surfaces.volume(vertices, faces) <= 0:
        raise Unfit("no volume")
    crossing = int(crossing_faces(vertices, faces).sum())
    if crossing:
        raise Unfit(f"{crossing} triangles that cut or touch each other")


def is_solid(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Return whether a surface passes :func:`judge`."""
    try:
        judge(vertices, faces)
    except Unfit:
        return False
    return True


def without_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return which faces (F,) have their corners on one line, within rounding."""
    longest = surfaces.edge_lengths(vertices, faces).max(axis=1)
    return 2 * surfaces.normals_and_areas(vertices, faces)[1] <= _FLAT_ASPECT * longest**2


def counted(count: int, what: str) -> str:
    """Return ``1 open edge`` or ``2 open edges``; the first noun takes the plural."""
    if count == 1:
        return f"1 {what}"
    nouns = ("edge", "point", "part", "triangle", "cavity", "piece", "hole", "body", "sheet")
    noun = next(word for word in what.split() if word in nouns)
    plural = noun[:-1] + "ies" if noun.endswith("y") else noun + "s"
    return f"{count} {what.replace(noun, plural, 1)}"
