"""From a closed surface to tetrahedra: one path for solid and hollow bodies.

The surface is remade at a size that gives about the wanted number of elements, then filled. Whether a shell
inside is a cavity makes no difference anywhere, so meshing can never tell solid from hollow. Recipes differ in
how much the surface must bend to be kept sharp; all bodies start with the same one, and the next gets its turn
only when no valid mesh comes of it.
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
from vibraverse.geometry.meshing.remesh import Evened, SheetsMeet
from vibraverse.geometry.meshing.sizing import Sizing

#: Ridges at which the normal turns by more than this many degrees stay sharp: the recipes, tried in this order.
RIDGES_DEG = (35.0, 50.0, 180.0, 25.0)
#: The element count may miss the target by this factor before the size is tried again, at most so often;
#: at first the size changes by this power of the miss.
_TOLERANCE, _TRIALS, _EXPONENT = 1.08, 5, 0.55
#: Elements should be no larger than this many times the body's mean thickness 2V/A. To that end there may be so many
#: times more of them than asked for.
_THICKNESSES, _MORE = 2.0, 2.0
#: A size at which sheets meet is followed by this share of it, the last time by one that fits the walls if none was
#: found until then; when they met so often, the recipe ends.
_STEP_BACK, _MEETINGS = 0.85, 3
#: Of the sizes tried so many are filled, until one gives a valid mesh.
_CANDIDATES = 3
#: A surface evened for one size serves others down to this share of it.
_STALE = 0.6
#: Sizes are not tried beyond this many times the first. Where this power of a miss did not mend it, the count comes
#: from what is small about the body and larger triangles elsewhere would spoil its shape: what is not far off is left.
_GROWN, _IDLE = 2.0, 1.0
#: A count this many times the wanted one is far off.
_FAR_OFF = 1.5
#: A remade surface has at most so many triangles, or so many times the elements wanted where that is more.
_LARGEST, _SURFACE = 100_000, 4.0
#: How far the remade surface may be from the original, as a share of the size.
_DEVIATION = 0.07
#: How much gmsh's second optimiser adds to the number of elements.
_OPTIMISED = 1.03
#: Below this many elements from one side to the other a wall counts as thin.
_THIN = 2.0
#: Opposite sides farther apart than this are not looked for; a body's longest side is 1.8.
_FAR = 4.0


@dataclass(frozen=True)
class TetMesh:
    """Tetrahedra: ``points`` (N, 3) float64, ``cells`` (T, 4) positively oriented, a ``quality`` table and what one
    should know about the mesh before trusting it: ``warnings``, sentences."""

    points: np.ndarray
    cells: np.ndarray
    quality: dict
    warnings: list[str]


@dataclass(frozen=True)
class _Remade:
    """A remade surface, the size it was made at, how many elements it should hold, and the logarithm of how many it
    does over that."""

    size: float
    points: np.ndarray
    triangles: np.ndarray
    wanted: float
    excess: float


def mesh_body(vertices: np.ndarray, faces: np.ndarray, options) -> TetMesh:
    """Run :func:`tetrahedralise` in a child process; ``options`` is the configuration's section ``tets``."""
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
    """Fill a closed, oriented, manifold surface with about ``target_elements`` tetrahedra, twice as many in thin walls.

    ``vertices`` (V, 3), ``faces`` (F, 3); shells inside the outermost one are cavities, oriented into it. Raises
    :class:`Refused` with reason ``meshing_failed`` when no recipe gives tetrahedra whose volume differs from the
    surface's by at most the share ``max_volume_change`` and whose faces all meet at ``min_dihedral_deg`` or more.
    """
    body = _Body(vertices, faces, max(_LARGEST, _SURFACE * target_elements))
    size = body.size_for(target_elements)
    complaints: list[str] = []
    met = False
    for body.yielding, ridge_deg in product((False, True), RIDGES_DEG):
        if body.yielding and not met:
            break
        try:
            trials = _sized(body, ridge_deg, size, target_elements)
        except (Refused, RuntimeError) as error:
            met = met or isinstance(error, SheetsMeet)
            complaints.append(getattr(error, "message", str(error)).rstrip("."))
            continue
        size = trials[0].size
        # Another size with the same ridges changes the body less than other ridges do.
        for remade, algorithm in product(trials[:_CANDIDATES], ALGORITHMS):
            try:
                nodes, cells = fill(remade.points, remade.triangles, algorithm)
                table = quality.table(nodes, cells)
                _check(nodes, cells, table, remade, body.volume, max_volume_change, min_dihedral_deg)
            except Refused as refused:
                complaints.append(refused.message.rstrip("."))
                continue
            table = {
                "ridge_deg": ridge_deg,
                "algorithm": algorithm,
                "wanted": round(remade.wanted),
                **table,
                "layers": _layers(remade),
            }
            nodes, cells = ordered(nodes, cells)
            return TetMesh(nodes, cells, table, cautions(len(cells), target_elements))
    raise Refused(
        "meshing_failed",
        f"No recipe filled the surface with tetrahedra: {'; '.join(dict.fromkeys(complaints))}.",
        "Repair or simplify the mesh, or raise tets.target_elements.",
    )


class _Body:
    """The surface to be meshed, what is asked of it more than once, and how many triangles it has at ``most``."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, most: float):
        self._surface, self._most = (vertices, faces), most
        self.volume, self.area = surfaces.volume(vertices, faces), surfaces.area(vertices, faces)
        self.thickness = 2 * self.volume / self.area
        self._evened: dict[float, Evened] = {}
        #: Whether the remade surface may lie less exactly where sheets are close, the last resort.
        self.yielding = False

    def count_at(self, size: float) -> float:
        """Return about how many elements of a size surface layer and inside together hold."""
        return 8 * self.area / size**2 + 8 * self.volume / size**3

    def size_for(self, count: float) -> float:
        """Return the size at which there are about so many."""
        low, high = 1e-4, 2.0
        for _ in range(60):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if self.count_at(middle) > count else (low, middle)
        return float(high)

    def remade(self, size: float, ridge_deg: float) -> Mesh:
        """Return the surface with triangles of about ``size``."""
        evened = self._evened.get(ridge_deg)
        if evened is None or size < _STALE * evened.size:
            sizing = Sizing(*self._surface, size)
            evened = Evened(*self._surface, size, sizing, _DEVIATION * size, ridge_deg, self._most)
            self._evened[ridge_deg] = evened
        return evened.remade(size, _DEVIATION * size, self.yielding)


def _sized(body: _Body, ridge_deg: float, size: float, target: int) -> list[_Remade]:
    """Remake the surface at sizes that give about ``target`` elements, starting from ``size``; the best comes first.

    Thin walls need triangles not much larger than they are thick: there the target is as many as elements of that size
    make, within bounds. A size at which sheets cut each other is too large unless there are far too many elements, for
    then it is worth a try whether larger ones cut each other, too; one far above the first changes the shape more than
    the count.
    """
    tried: list[_Remade] = []
    largest, too_large, meetings = _GROWN * size, np.inf, 0
    for _ in range(_TRIALS):
        try:
            points, triangles = body.remade(size, ridge_deg)
            count = _OPTIMISED * len(fill(points, triangles, optimise=False)[1])
        except SheetsMeet:
            too_large, meetings = min(too_large, size), meetings + 1
            if meetings == _MEETINGS:
                break
            size *= _STEP_BACK
            if meetings == _MEETINGS - 1 and not tried:
                size = min(size, _THICKNESSES * body.thickness)
            continue
        except (Refused, RuntimeError):
            if tried:
                break
            raise
        thin = count * body.count_at(_THICKNESSES * body.thickness) / body.count_at(size)
        wanted = float(np.clip(thin, target, _MORE * target))
        tried.append(_Remade(size, points, triangles, wanted, float(np.log(count / wanted))))
        if abs(tried[-1].excess) < np.log(_TOLERANCE):
            break
        exponent = _exponent(tried)
        if exponent > _IDLE and 0 < tried[-1].excess < np.log(_FAR_OFF):
            break
        size *= float(np.clip(np.exp(exponent * tried[-1].excess), 0.5, 2.0))
        if size > largest or (size > _STEP_BACK * too_large and tried[-1].excess < np.log(_FAR_OFF)):
            break
    if not tried:
        raise SheetsMeet(f"sheets of the surface are closer than triangles of {too_large:.3g}")
    return sorted(tried, key=lambda trial: abs(trial.excess))


def _exponent(tried: list[_Remade]) -> float:
    """Return by which power of the count's error the size should change, from the last two trials."""
    if len(tried) < 2:
        return _EXPONENT
    first, second = tried[-2:]
    apart, step = first.excess - second.excess, float(np.log(second.size / first.size))
    return float(np.clip(step / apart, 0.25, 1.5)) if step * apart > 0 else 1.5


def _check(
    nodes, cells, table, remade: _Remade, wanted: float, max_change: float, min_dihedral_deg: float
) -> None:
    """Raise when the tetrahedra are not a valid mesh of the wanted body."""
    volumes = quality.volumes(nodes, cells)
    if volumes.min() <= 0:
        raise Refused("meshing_failed", f"{(volumes <= 0).sum()} tetrahedra are flat or turned inside out")
    enclosed = surfaces.volume(remade.points, remade.triangles)
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


def _layers(remade: _Remade) -> dict:
    """Return how many elements lie between opposite sides of the body, over its surface."""
    points, triangles = remade.points, remade.triangles
    lengths = np.repeat(surfaces.edge_lengths(points, triangles).mean(axis=1), 3)
    around = np.bincount(triangles.ravel(), lengths) / np.bincount(triangles.ravel())
    depth = depth_below(points, triangles, surfaces.vertex_normals(points, triangles), _FAR)
    layers = depth / around
    p05, median = np.percentile(layers, (5, 50))
    return {
        "p05": round(float(p05), 3),
        "median": round(float(median), 3),
        "thin_share": round(float((layers < _THIN).mean()), 3),
    }
