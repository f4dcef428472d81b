"""Tetrahedral meshing of a closed surface, the same for solid and hollow bodies.

The surface is remeshed at a size that gives about the wanted number of elements, then filled. Inner shells are
treated like any other, so the mesher cannot tell solid from hollow. Recipes differ in the angle above which edges
stay sharp. All bodies start with the same recipe; the next is tried only if that gives no valid mesh. Where all fail,
or their tools crash, fTetWild fills a surface that it keeps within an envelope.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.boundary import boundary
from vibraverse.geometry.distance.sight import depth_below
from vibraverse.geometry.meshing import quality
from vibraverse.geometry.meshing.cautions import cautions
from vibraverse.geometry.meshing.envelope import ENVELOPES, fill_within
from vibraverse.geometry.meshing.fill import ALGORITHMS, fill, ordered
from vibraverse.geometry.meshing.remesh import EvenSurface, SheetsMeet
from vibraverse.geometry.meshing.sizing import Sizing

#: The recipes in the order of trial: ridges stay sharp if the normal turns by more than this many degrees.
RIDGES_DEG = (35.0, 50.0, 180.0, 25.0)
#: Largest factor between element count and target, the most sizes tried, and the first exponent: the size changes by
#: this power of the factor.
_COUNT_TOLERANCE, _MAX_TRIALS, _FIRST_EXPONENT = 1.08, 5, 0.55
#: Wanted upper bound on the element size in mean thicknesses 2V/A of the body, and the largest factor by which it may
#: raise the target.
_MAX_THICKNESSES, _MAX_EXCESS = 2.0, 2.0
#: Factor on the size after sheets met, and the number of meetings at which the recipe ends. If no size has worked
#: before the last retry, that one fits the walls.
_SIZE_REDUCTION, _MAX_MEETINGS = 0.85, 3
#: Most sizes that are filled until one gives a valid mesh.
_MAX_CANDIDATES = 3
#: An even surface made for one size serves sizes down to this share of it.
_MIN_REUSE = 0.6
#: Largest size in multiples of the first. An exponent above the second number is futile: the count comes from small
#: features, and larger triangles elsewhere would spoil the shape. The search then ends unless the count is far off.
_MAX_SIZE_GROWTH, _FUTILE_EXPONENT = 2.0, 1.0
#: A count beyond this many times the wanted one is far off.
_FAR_FACTOR = 1.5
#: Limit on the triangles of a remeshed surface: this number, or this many per wanted element if that is more.
_MIN_TRIANGLE_LIMIT, _TRIANGLES_PER_ELEMENT = 100_000, 4.0
#: Largest distance of the remeshed surface from the original, as a share of the size.
_MAX_DEVIATION = 0.07
#: Factor by which Netgen's optimiser raises the number of elements.
_OPTIMISER_GROWTH = 1.03
#: A wall with fewer elements than this from side to side counts as thin.
_THIN_LAYERS = 2.0
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


@dataclass(frozen=True)
class _Trial:
    """A surface remeshed at one ``size``.

    ``wanted`` is the number of elements that it should hold, ``excess`` the logarithm of actual over wanted number.
    """

    size: float
    points: np.ndarray
    triangles: np.ndarray
    wanted: float
    excess: float


def mesh_body(vertices: np.ndarray, faces: np.ndarray, options) -> TetMesh:
    """Do what :func:`tetrahedralise` does in child processes; ``options`` is the section ``tets`` of the configuration.

    Each way has the limits for itself, so one that hangs or crashes costs no more than them.
    """
    from vibraverse.contract.limits import run_limited

    def attempt(way: Callable, tools: str) -> TetMesh:
        return run_limited(
            way,
            vertices,
            faces,
            _Demands.of(
                vertices, faces, options.target_elements, options.max_volume_change, options.min_dihedral_deg
            ),
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
) -> TetMesh:
    """Fill a closed, oriented, manifold surface with about ``target_elements`` tetrahedra.

    Thin-walled bodies may get twice as many. ``vertices`` (V, 3), ``faces`` (F, 3); shells inside the outermost one are
    cavities, with normals that point into them. Raises :class:`Refused` with reason ``meshing_failed`` when nothing
    gives a valid mesh: one whose volume differs from the surface's by at most the share ``max_volume_change`` and whose
    dihedral angles are at least ``min_dihedral_deg``.
    """
    demands = _Demands.of(vertices, faces, target_elements, max_volume_change, min_dihedral_deg)
    return _first(lambda way, tools: way(vertices, faces, demands))


def _first(attempt: Callable[[Callable, str], TetMesh]) -> TetMesh:
    """Return what the first way of meshing gives that is not refused; ``attempt`` calls one with its tools' names."""
    refusals = []
    for way, tools in ((_by_recipes, "gmsh with Mmg"), (_within_envelope, "fTetWild")):
        try:
            return attempt(way, tools)
        except Refused as refused:
            refusals.append(refused)
    first = refusals[0]
    said = " ".join(dict.fromkeys(refused.message for refused in refusals))
    raise Refused(first.reason, f"Nothing filled the surface with tetrahedra. {said}", first.advice)


@dataclass(frozen=True)
class _Demands:
    """What a mesh must fulfil: about so many ``elements``, the ``volume`` but for a share, the least angle."""

    elements: int
    volume: float
    max_change: float
    min_dihedral_deg: float

    @classmethod
    def of(cls, vertices, faces, elements: int, max_change: float, min_dihedral_deg: float) -> _Demands:
        """Return the demands on the mesh of a surface."""
        return cls(elements, surfaces.volume(vertices, faces), max_change, min_dihedral_deg)


def _by_recipes(vertices: np.ndarray, faces: np.ndarray, demands: _Demands) -> TetMesh:
    """Return the mesh of the first recipe that gives a valid one; raise :class:`Refused` if none does."""
    body = _Body(vertices, faces, max(_MIN_TRIANGLE_LIMIT, _TRIANGLES_PER_ELEMENT * demands.elements))
    size, met = body.size_for(demands.elements), False
    complaints: list[str] = []
    for body.yielding, ridge_deg in product((False, True), RIDGES_DEG):
        if body.yielding and not met:
            break
        try:
            trials = _search_size(body, ridge_deg, size, demands.elements)
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
                complaints.append(refused.message.rstrip("."))
    raise _failed("gmsh with Mmg", complaints)


def _within_envelope(vertices: np.ndarray, faces: np.ndarray, demands: _Demands) -> TetMesh:
    """Return a mesh whose surface stays within an envelope of the body's; raise :class:`Refused` if it is not valid."""
    body = _Body(vertices, faces, np.inf)
    complaints = []
    for share in ENVELOPES:
        try:
            points, cells = fill_within(
                vertices, faces, body.size_for(demands.elements), share * body.thickness
            )
            triangles, nodes = boundary(cells)
            recipe = {"ridge_deg": None, "algorithm": "ftetwild", "wanted": demands.elements}
            return _checked(points, cells, (points[nodes], triangles), demands, recipe)
        except Refused as refused:
            complaints.append(refused.message.rstrip("."))
    raise _failed("fTetWild", complaints)


def _failed(tools: str, complaints: list[str]) -> Refused:
    return Refused(
        "meshing_failed",
        f"{tools}: {'; '.join(dict.fromkeys(complaints))}.",
        "Repair or simplify the mesh, or raise tets.target_elements.",
    )


class _Body:
    """The surface of a body, with cached values; ``most`` bounds the triangles of remeshed surfaces."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, most: float):
        self.surface, self._most = (vertices, faces), most
        self.volume, self.area = surfaces.volume(vertices, faces), surfaces.area(vertices, faces)
        self.thickness = 2 * self.volume / self.area
        self._even: dict[float, EvenSurface] = {}
        #: Whether the fit may yield where sheets are close: the last resort.
        self.yielding = False

    def count_at(self, size: float) -> float:
        """Return the approximate number of elements of a size, in the surface layer and inside."""
        return 8 * self.area / size**2 + 8 * self.volume / size**3

    def size_for(self, count: float) -> float:
        """Return the size that gives about ``count`` elements, by bisection of :meth:`count_at`."""
        low, high = 1e-4, 2.0
        for _ in range(60):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if self.count_at(middle) > count else (low, middle)
        return float(high)

    def remesh(self, size: float, ridge_deg: float) -> Mesh:
        """Return the surface remeshed with triangles of about ``size``."""
        even = self._even.get(ridge_deg)
        if even is None or size < _MIN_REUSE * even.size:
            sizing = Sizing(*self.surface, size)
            even = EvenSurface(*self.surface, size, sizing, _MAX_DEVIATION * size, ridge_deg, self._most)
            self._even[ridge_deg] = even
        return even.remesh(size, _MAX_DEVIATION * size, self.yielding)


def _search_size(body: _Body, ridge_deg: float, size: float, target: int) -> list[_Trial]:
    """Remesh the surface at sizes that give about ``target`` elements, starting from ``size``; the best comes first.

    Thin walls need triangles not much larger than their thickness, which raises the target within bounds. A size at
    which sheets cut each other is too large. A still larger one is tried only if there are far too many elements.
    Sizes far above the first would change the shape more than the count.
    """
    tried: list[_Trial] = []
    largest, too_large, meetings = _MAX_SIZE_GROWTH * size, np.inf, 0
    for _ in range(_MAX_TRIALS):
        try:
            points, triangles = body.remesh(size, ridge_deg)
            count = _OPTIMISER_GROWTH * len(fill(points, triangles, optimise=False)[1])
        except SheetsMeet:
            too_large, meetings = min(too_large, size), meetings + 1
            if meetings == _MAX_MEETINGS:
                break
            size *= _SIZE_REDUCTION
            if meetings == _MAX_MEETINGS - 1 and not tried:
                size = min(size, _MAX_THICKNESSES * body.thickness)
            continue
        except (Refused, RuntimeError):
            if tried:
                break
            raise
        thin = count * body.count_at(_MAX_THICKNESSES * body.thickness) / body.count_at(size)
        wanted = float(np.clip(thin, target, _MAX_EXCESS * target))
        tried.append(_Trial(size, points, triangles, wanted, float(np.log(count / wanted))))
        if abs(tried[-1].excess) < np.log(_COUNT_TOLERANCE):
            break
        exponent = _exponent(tried)
        if exponent > _FUTILE_EXPONENT and 0 < tried[-1].excess < np.log(_FAR_FACTOR):
            break
        size *= float(np.clip(np.exp(exponent * tried[-1].excess), 0.5, 2.0))
        if size > largest or (size > _SIZE_REDUCTION * too_large and tried[-1].excess < np.log(_FAR_FACTOR)):
            break
    if not tried:
        raise SheetsMeet(f"sheets of the surface are closer than triangles of {too_large:.3g}")
    return sorted(tried, key=lambda trial: abs(trial.excess))


def _exponent(tried: list[_Trial]) -> float:
    """Return the power of the count's error by which the size should change: a secant step of two trials."""
    if len(tried) < 2:
        return _FIRST_EXPONENT
    first, second = tried[-2:]
    apart, step = first.excess - second.excess, float(np.log(second.size / first.size))
    return float(np.clip(step / apart, 0.25, 1.5)) if step * apart > 0 else 1.5


def _checked(
    points: np.ndarray, cells: np.ndarray, surface: Mesh, demands: _Demands, recipe: dict
) -> TetMesh:
    """Return the mesh with its quality table; raise :class:`Refused` unless it fills its surface and is as demanded."""
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
    table = {**recipe, **table, "layers": _layers(*surface)}
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
