"""Tetrahedral meshing of a closed surface, the same for solid and hollow bodies.

The surface is remeshed at a size that gives about the wanted number of elements, then filled. Inner shells are
treated like any other, so the mesher cannot tell solid from hollow. Recipes differ in the angle above which edges
stay sharp. All bodies start with the same recipe; the next is tried only if that gives no valid mesh, or takes more
work or more elements than a body may. Where all fail, or their tools crash, fTetWild fills a surface that it keeps
within an envelope. What that cannot fill either is wrapped and then filled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.contract.progress import report
from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.boundary import boundary
from vibraverse.geometry.distance.sight import depth_below
from vibraverse.geometry.meshing import quality
from vibraverse.geometry.meshing.accuracy import accuracy
from vibraverse.geometry.meshing.cautions import cautions
from vibraverse.geometry.meshing.envelope import ENVELOPE, NARROW_ENVELOPE, WIDE_ENVELOPE, fill_within
from vibraverse.geometry.meshing.fill import ALGORITHMS, fill, ordered
from vibraverse.geometry.meshing.remesh import SheetsMeet
from vibraverse.geometry.meshing.sizes import Body, TooMany, search_size
from vibraverse.geometry.meshing.work import OPTIMISED, Work
from vibraverse.geometry.meshing.wrapped import WRAPS, wrapped

#: The recipes in the order of trial: ridges stay sharp if the normal turns by more than this many degrees.
RIDGES_DEG = (35.0, 50.0, 180.0, 25.0)
#: Most sizes that are filled until one gives a valid mesh.
_MAX_CANDIDATES = 3
#: A wall with fewer elements than this from side to side counts as thin.
_THIN_LAYERS = 2.0
#: A body may always have this many times the elements that are asked for.
_MIN_TIMES_TARGET = 3.0
#: Largest thickness that is measured; a body's longest side is 1.8.
_MAX_DEPTH = 4.0


@dataclass(frozen=True)
class TetMesh:
    """A tetrahedral mesh: ``points`` (N, 3) float64 and positively oriented ``cells`` (T, 4).

    ``quality`` is a table of measures, ``warnings`` a list of sentences.
    """

    points: np.ndarray
    cells: np.ndarray
    quality: dict
    warnings: list[str]


def mesh_body(vertices: np.ndarray, faces: np.ndarray, options) -> TetMesh:
    """Do what :func:`tetrahedralise` does in child processes; ``options`` is the section ``tets`` of the configuration.

    Each way has the limits for itself, so one that hangs or crashes costs no more than them.
    """
    from vibraverse.contract.limits import run_limited

    demands = _Demands.of(
        vertices,
        faces,
        options.target_elements,
        options.max_volume_change,
        options.min_dihedral_deg,
        options.max_elements,
        options.max_wrap_change,
    )

    def attempt(way: Callable, tools: str) -> TetMesh:
        return run_limited(
            way,
            vertices,
            faces,
            demands,
            seconds=options.limits.seconds,
            memory_mb=options.limits.memory_mb,
            key="tets.limits",
            what=tools,
        )

    return _first(attempt)


def tetrahedralise(
    vertices: np.ndarray,
    faces: np.ndarray,
    target_elements: int = 5000,
    max_volume_change: float = 0.005,
    min_dihedral_deg: float = 0.1,
    max_elements: int = 24_000,
    max_wrap_change: float = 0.05,
) -> TetMesh:
    """Fill a closed, oriented, manifold surface with about ``target_elements`` tetrahedra.

    Thin-walled bodies may get twice as many. ``vertices`` (V, 3), ``faces`` (F, 3); shells inside the outermost one are
    cavities, with normals that point into them. Raises :class:`Refused` with reason ``meshing_failed`` when nothing
    gives a valid mesh: one whose volume differs from the surface's by at most the share ``max_volume_change`` and whose
    dihedral angles are at least ``min_dihedral_deg``, with at most ``max_elements`` tetrahedra, or three times the
    target if that is more. As a last resort the surface is wrapped, if that changes its volume by at most the share
    ``max_wrap_change``; 0 rules that out.
    """
    demands = _Demands.of(
        vertices, faces, target_elements, max_volume_change, min_dihedral_deg, max_elements, max_wrap_change
    )
    return _first(lambda way, tools: way(vertices, faces, demands))


def _first(attempt: Callable[[Callable, str], TetMesh]) -> TetMesh:
    """Return what the first way of meshing gives that is not refused; ``attempt`` calls one with its tools' names."""
    refusals = []
    for way, tools in (
        (_by_recipes, "gmsh with Mmg"),
        (_within_envelope, "fTetWild"),
        (_by_wraps, "Wrapping"),
    ):
        try:
            return attempt(way, tools)
        except Refused as refused:
            report(f"{tools} failed: {refused.message}")
            refusals.append(refused)
    first = refusals[0]
    said = " ".join(dict.fromkeys(refused.message for refused in refusals))
    raise Refused(first.reason, f"Nothing filled the surface with tetrahedra. {said}", first.advice)


@dataclass(frozen=True)
class _Demands:
    """What a mesh of a surface must fulfil: about so many ``elements`` and never above ``most``, the ``volume``.

    ``given`` is the surface that the body came with, from which its mesh may differ after a wrap.
    """

    given: Mesh
    elements: int
    most: float
    volume: float
    max_change: float
    min_dihedral_deg: float
    max_wrap_change: float

    @classmethod
    def of(
        cls,
        vertices,
        faces,
        elements: int,
        max_change: float,
        min_dihedral_deg: float,
        max_elements: int,
        max_wrap_change: float,
    ) -> _Demands:
        """Return the demands on the mesh of a surface."""
        most = max(max_elements, _MIN_TIMES_TARGET * elements)
        enclosed = surfaces.volume(vertices, faces)
        return cls((vertices, faces), elements, most, enclosed, max_change, min_dihedral_deg, max_wrap_change)


def _by_recipes(
    vertices: np.ndarray, faces: np.ndarray, demands: _Demands, work: Work | None = None
) -> TetMesh:
    """Return the mesh of the first recipe that gives a valid one; raise :class:`Refused` if none does."""
    body = Body(vertices, faces, demands.elements, demands.most, work)
    size, met = body.size, False
    complaints: list[str] = []
    for body.yielding, ridge_deg in product((False, True), RIDGES_DEG):
        if (body.yielding and not met) or body.work.exhausted:
            break
        report(f"remeshing, sharp above {ridge_deg:g}°{', where sheets allow it' * body.yielding}")
        body.work.begin()
        try:
            trials = search_size(body, ridge_deg, size, demands.elements)
        except (Refused, RuntimeError) as error:
            met = met or isinstance(error, SheetsMeet)
            complaints.append(getattr(error, "message", str(error)).rstrip("."))
            continue
        size = trials[0].size
        # Another size with the same ridges changes the body less than another recipe.
        for trial, algorithm in product(trials[:_MAX_CANDIDATES], ALGORITHMS):
            try:
                filled = fill(trial.points, trial.triangles, algorithm)
                recipe = {"ridge_deg": ridge_deg, "algorithm": algorithm, "wanted": round(trial.wanted)}
                return _checked(*filled, (trial.points, trial.triangles), demands, recipe)
            except Refused as refused:
                report(f"{algorithm}: {refused.message}")
                complaints.append(refused.message.rstrip("."))
            body.work.add(trial.count, OPTIMISED)
            if body.work.exhausted:
                break
    raise _failed("gmsh with Mmg", complaints)


def _within_envelope(vertices: np.ndarray, faces: np.ndarray, demands: _Demands) -> TetMesh:
    """Return a mesh whose surface stays within an envelope of the body's; raise :class:`Refused` if it is not valid."""
    body = Body(vertices, faces, demands.elements, demands.most)
    complaints, share = [], ENVELOPE
    while share:
        report(f"fTetWild within an envelope of {100 * share:g} % of the thickness")
        try:
            points, cells = fill_within(vertices, faces, body.size, share * body.thickness)
            triangles, nodes = boundary(cells)
            recipe = {"ridge_deg": None, "algorithm": "ftetwild", "wanted": demands.elements}
            return _checked(points, cells, (points[nodes], triangles), demands, recipe)
        except Refused as refused:
            complaints.append(refused.message.rstrip("."))
            other = WIDE_ENVELOPE if isinstance(refused, TooMany) else NARROW_ENVELOPE
            share = other if share == ENVELOPE else None
    raise _failed("fTetWild", complaints)


def _by_wraps(vertices: np.ndarray, faces: np.ndarray, demands: _Demands) -> TetMesh:
    """Return a mesh of the wrapped surface, whose volume may differ a little; raise :class:`Refused` without one."""
    complaints, work = [], Work(demands.most)
    for radius, offset in WRAPS if demands.max_wrap_change else ():
        if work.exhausted:
            break
        try:
            surface = wrapped(vertices, faces, radius, offset, demands.max_wrap_change)
        except Refused as refused:
            complaints.append(refused.message.rstrip("."))
            continue
        wanted = replace(demands, volume=surfaces.volume(*surface))
        for way, *more in ((_by_recipes, work), (_within_envelope,)):
            try:
                mesh = way(*surface, wanted, *more)
            except Refused as refused:
                complaints.append(refused.message.rstrip("."))
            else:
                return replace(mesh, quality={**mesh.quality, "wrap": {"radius": radius, "offset": offset}})
    raise _failed("Wrapping", complaints or ["tets.max_wrap_change is 0"])


def _failed(tools: str, complaints: list[str]) -> Refused:
    return Refused(
        "meshing_failed",
        f"{tools}: {'; '.join(dict.fromkeys(complaints))}.",
        "Repair or simplify the mesh, or raise tets.target_elements.",
    )


def _checked(
    points: np.ndarray, cells: np.ndarray, surface: Mesh, demands: _Demands, recipe: dict
) -> TetMesh:
    """Return the mesh with its quality table; raise :class:`Refused` unless it fills its surface and is as demanded."""
    if len(cells) > demands.most:
        raise TooMany.of(len(cells), demands.most)
    table = quality.table(points, cells)
    volumes, enclosed = quality.volumes(points, cells), surfaces.volume(*surface)
    if volumes.min() <= 0:
        raise Refused("meshing_failed", f"{(volumes <= 0).sum()} tetrahedra are flat or turned inside out")
    if abs(volumes.sum() - enclosed) > 1e-9 * enclosed:
        raise Refused("meshing_failed", "the tetrahedra do not fill the surface")
    if quality.parts(cells, len(points)) != 1:
        raise Refused("meshing_failed", "the tetrahedra fall apart")
    change = abs(volumes.sum() / demands.volume - 1.0)
    if change > demands.max_change:
        raise Refused("meshing_failed", f"remeshing the surface changed the volume by {100 * change:.2g} %")
    angle = table["min_dihedral_deg"]["min"]
    if angle < demands.min_dihedral_deg:
        raise Refused(
            "meshing_failed", f"a tetrahedron has an angle of {angle:.2g} degrees between two faces"
        )
    table = {
        **recipe,
        **table,
        "layers": _layers(*surface),
        "accuracy": accuracy(demands.given, surface),
    }
    return TetMesh(*ordered(points, cells), table, cautions(len(cells), demands.elements))


def _layers(points: np.ndarray, triangles: np.ndarray) -> dict:
    """Return statistics over a surface of the number of elements between its opposite sides."""
    lengths = np.repeat(surfaces.edge_lengths(points, triangles).mean(axis=1), 3)
    around = np.bincount(triangles.ravel(), lengths) / np.bincount(triangles.ravel())
    depth = depth_below(points, triangles, surfaces.vertex_normals(points, triangles), _MAX_DEPTH)
    layers = depth / around
    p05, median = np.percentile(layers, (5, 50))
    return {
        "p05": round(float(p05), 3),
        "median": round(float(median), 3),
        "thin_share": round(float((layers < _THIN_LAYERS).mean()), 3),
    }
