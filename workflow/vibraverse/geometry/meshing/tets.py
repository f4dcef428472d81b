"""Tetrahedral meshing of a closed surface, the same for solid and hollow bodies.

The surface is remeshed at a size that gives about the wanted number of elements, then filled. Inner shells are
treated like any other, so the mesher cannot tell solid from hollow. Recipes differ in the angle above which edges
stay sharp. All bodies start with the same recipe; the next is tried only if that gives no valid mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.distance.sight import depth_below
from vibraverse.geometry.meshing import quality
from vibraverse.geometry.meshing.cautions import cautions
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
    """Run :func:`tetrahedralise` in a child process; ``options`` is the section ``tets`` of the configuration."""
    from vibraverse.contract.limits import run_limited

    return run_limited(
        tetrahedralise,
        vertices,
        faces,
        options.target_elements,
        options.max_volume_change,
        options.min_dihedral_deg,
        seconds=options.limits.seconds,
        memory_mb=options.limits.memory_mb,
        key="tets.limits",
        what="The mesher",
    )


def tetrahedralise(
    vertices: np.ndarray,
    faces: np.ndarray,
    target_elements: int = 5000,
    max_volume_change: float = 0.005,
    min_dihedral_deg: float = 0.1,
) -> TetMesh:
    """Fill a closed, oriented, manifold surface with about ``target_elements`` tetrahedra.

    Thin-walled bodies may get twice as many. ``vertices`` (V, 3), ``faces`` (F, 3); shells inside the outermost one are
    cavities, with normals that point into them. Raises :class:`Refused` with reason ``meshing_failed`` when no recipe
    gives a valid mesh: one whose volume differs from the surface's by at most the share ``max_volume_change`` and whose
    dihedral angles are at least ``min_dihedral_deg``.
    """
    body = _Body(vertices, faces, max(_MIN_TRIANGLE_LIMIT, _TRIANGLES_PER_ELEMENT * target_elements))
    size = body.size_for(target_elements)
    complaints: list[str] = []
    met = False
    for body.yielding, ridge_deg in product((False, True), RIDGES_DEG):
        if body.yielding and not met:
            break
        try:
            trials = _search_size(body, ridge_deg, size, target_elements)
        except (Refused, RuntimeError) as error:
            met = met or isinstance(error, SheetsMeet)
            complaints.append(getattr(error, "message", str(error)).rstrip("."))
            continue
        size = trials[0].size
        # Another size with the same ridges changes the body less than another recipe.
        for trial, algorithm in product(trials[:_MAX_CANDIDATES], ALGORITHMS):
            try:
                nodes, cells = fill(trial.points, trial.triangles, algorithm)
                table = quality.table(nodes, cells)
                _check(nodes, cells, table, trial, body.volume, max_volume_change, min_dihedral_deg)
            except Refused as refused:
                complaints.append(refused.message.rstrip("."))
                continue
            table = {
                "ridge_deg": ridge_deg,
                "algorithm": algorithm,
                "wanted": round(trial.wanted),
                **table,
                "layers": _layers(trial),
            }
            nodes, cells = ordered(nodes, cells)
            return TetMesh(nodes, cells, table, cautions(len(cells), target_elements))
    raise Refused(
        "meshing_failed",
        f"No recipe filled the surface with tetrahedra: {'; '.join(dict.fromkeys(complaints))}.",
        "Repair or simplify the mesh, or raise tets.target_elements.",
    )


class _Body:
    """The surface of a body, with cached values; ``most`` bounds the triangles of remeshed surfaces."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, most: float):
        self._surface, self._most = (vertices, faces), most
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
            sizing = Sizing(*self._surface, size)
            even = EvenSurface(*self._surface, size, sizing, _MAX_DEVIATION * size, ridge_deg, self._most)
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


def _check(
    nodes, cells, table, trial: _Trial, wanted: float, max_change: float, min_dihedral_deg: float
) -> None:
    """Raise :class:`Refused` unless the tetrahedra are a valid mesh of a body with the ``wanted`` volume."""
    volumes = quality.volumes(nodes, cells)
    if volumes.min() <= 0:
        raise Refused("meshing_failed", f"{(volumes <= 0).sum()} tetrahedra are flat or turned inside out")
    enclosed = surfaces.volume(trial.points, trial.triangles)
    if abs(volumes.sum() - enclosed) > 1e-9 * enclosed:
        raise Refused("meshing_failed", "the tetrahedra do not fill the surface")
    if quality.parts(cells, len(nodes)) != 1:
        raise Refused("meshing_failed", "the tetrahedra fall apart")
    change = abs(volumes.sum() / wanted - 1.0)
    if change > max_change:
        raise Refused("meshing_failed", f"remeshing the surface changed the volume by {100 * change:.2g} %")
    angle = table["min_dihedral_deg"]["min"]
    if angle < min_dihedral_deg:
        raise Refused(
            "meshing_failed", f"a tetrahedron has an angle of {angle:.2g} degrees between two faces"
        )


def _layers(trial: _Trial) -> dict:
    """Return statistics over the surface of the number of elements between opposite sides."""
    points, triangles = trial.points, trial.triangles
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
