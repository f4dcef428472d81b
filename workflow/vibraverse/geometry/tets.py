"""From a closed surface to tetrahedra: one path for solid and hollow bodies.

The surface is remade at a size that gives about the wanted number of elements, then filled. Whether a shell
inside is a cavity makes no difference anywhere, so meshing can never tell solid from hollow. Recipes differ in
which edges they keep sharp: with few sharp edges triangles are better shaped, with many the shape is closer.
The first whose triangles are well shaped is taken; when filling fails, the next one gets its turn before the
body is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vibraverse.geometry import quality, surfaces
from vibraverse.geometry.fill import ALGORITHMS, fill
from vibraverse.geometry.remesh import SheetsMeet, remesh
from vibraverse.refusal import Refused

#: Edges at which the normal turns by more than this many degrees stay sharp: recipes in rows. The first good one of
#: a row is taken, else its best; the next row is for when none of it works.
RIDGES_DEG = ((35.0, 50.0), (180.0,), (25.0,))
#: A triangle with a smaller angle is poor. A surface with no more than this share of poor ones is taken at once.
_POOR_DEG, _FEW_POOR = 5.0, 1e-3
#: Missing the target by more than the first factor counts like a share of poor triangles, in proportion.
_ACCEPTED, _FAR_OFF = 1.3, 0.05
#: The element count may miss the target by this factor before the size is tried again, at most so often;
#: at first the size changes by this power of the miss.
_TOLERANCE, _TRIALS, _EXPONENT = 1.15, 4, 0.55
#: A size at which sheets meet is followed by this share of it.
_STEP_BACK = 0.7
#: How much gmsh's second optimiser adds to the number of elements.
_OPTIMISED = 1.03


@dataclass(frozen=True)
class TetMesh:
    """Tetrahedra: ``points`` (N, 3) float64, ``cells`` (T, 4) positively oriented, and a ``quality`` table."""

    points: np.ndarray
    cells: np.ndarray
    quality: dict


@dataclass(frozen=True)
class _Candidate:
    """A remade surface, what made it, the share of its triangles that are poor, and the logarithm of its
    element count over the target."""

    ridge_deg: float
    size: float
    points: np.ndarray
    triangles: np.ndarray
    poor: float
    excess: float = 0.0

    @property
    def demerit(self) -> float:
        """How much speaks against it: poor triangles, and an element count far from the target."""
        return self.poor + _FAR_OFF * max(abs(self.excess) - np.log(_ACCEPTED), 0.0)


def mesh_body(vertices: np.ndarray, faces: np.ndarray, options) -> TetMesh:
    """Run :func:`tetrahedralise` in a child process; ``options`` is the configuration's section ``tets``."""
    from vibraverse.limits import run_limited

    return run_limited(
        tetrahedralise,
        vertices,
        faces,
        options.target_elements,
        options.max_volume_change,
        seconds=options.limits.seconds,
        memory_mb=options.limits.memory_mb,
        what="the mesher",
    )


def tetrahedralise(
    vertices: np.ndarray, faces: np.ndarray, target_elements: int = 5000, max_volume_change: float = 0.005
) -> TetMesh:
    """Fill a closed, oriented, manifold surface with about ``target_elements`` tetrahedra.

    ``vertices`` (V, 3), ``faces`` (F, 3); shells inside the outermost one are cavities, oriented into it. Raises
    :class:`Refused` with reason ``meshing_failed`` when no recipe gives valid tetrahedra whose volume differs
    from the surface's by at most the share ``max_volume_change``.
    """
    wanted = surfaces.volume(vertices, faces)
    size = _first_size(surfaces.area(vertices, faces), wanted, target_elements)
    complaints: list[str] = []
    for row in RIDGES_DEG:
        candidates: list[_Candidate] = []
        for ridge_deg in row:
            try:
                candidate = _sized(vertices, faces, ridge_deg, size, target_elements)
            except (Refused, RuntimeError) as error:
                complaints.append(getattr(error, "message", str(error)))
                continue
            candidates.append(candidate)
            size = candidate.size
            if candidate.demerit <= _FEW_POOR:
                break
        for candidate in sorted(candidates, key=lambda candidate: candidate.demerit):
            mesh = _filled(candidate, wanted, max_volume_change, complaints)
            if mesh is not None:
                return mesh
    raise Refused(
        "meshing_failed",
        f"No recipe filled the surface with tetrahedra: {'; '.join(dict.fromkeys(complaints))}.",
        "Repair or simplify the mesh, or raise tets.target_elements.",
    )


def _sized(vertices, faces, ridge_deg: float, size: float, target: int) -> _Candidate:
    """Remake the surface at the size that gives about ``target`` elements, starting from ``size``.

    Thin walls need triangles not much larger than they are thick: a size at which sheets cut each other is too
    large whatever the target. When that happens twice running this recipe will not do.
    """
    tried: list[tuple[float, _Candidate]] = []
    too_large = np.inf
    for _ in range(_TRIALS):
        try:
            candidate = _remade(vertices, faces, size, ridge_deg)
        except SheetsMeet:
            if too_large < np.inf and not tried:
                break
            too_large = min(too_large, size)
            size *= _STEP_BACK
            continue
        count = len(fill(candidate.points, candidate.triangles, optimise=False)[1])
        excess = float(np.log(_OPTIMISED * count / target))
        tried.append((excess, replace(candidate, excess=excess)))
        if abs(excess) < np.log(_TOLERANCE):
            break
        size *= float(np.clip(np.exp(_exponent(tried) * excess), 0.5, 2.0))
        if size > _STEP_BACK * too_large:
            break
    if not tried:
        raise SheetsMeet(f"sheets of the surface are closer than triangles of {too_large:.3g}")
    return min(tried, key=lambda trial: abs(trial[0]))[1]


def _remade(vertices, faces, size: float, ridge_deg: float) -> _Candidate:
    points, triangles = remesh(vertices, faces, size, ridge_deg=ridge_deg)
    poor = float((_smallest_angle_deg(points, triangles) < _POOR_DEG).mean())
    return _Candidate(ridge_deg, size, points, triangles, poor)


def _exponent(tried: list) -> float:
    """Return by which power of the count's error the size should change, from the last two trials."""
    if len(tried) < 2:
        return _EXPONENT
    (before, first), (now, second) = tried[-2:]
    slope = np.log(second.size / first.size) / (before - now) if before != now else _EXPONENT
    return float(np.clip(slope, 0.25, 1.5))


def _first_size(area: float, volume: float, target: int) -> float:
    """Return the edge length at which surface layer and inside together hold about ``target`` elements."""
    low, high = 1e-4, 2.0
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (
            (middle, high) if 8 * area / middle**2 + 8 * volume / middle**3 > target else (low, middle)
        )
    return float(high)


def _filled(
    candidate: _Candidate, wanted: float, max_volume_change: float, complaints: list[str]
) -> TetMesh | None:
    """Fill a remade surface by the first algorithm that gives a valid mesh, or say why none does."""
    enclosed = surfaces.volume(candidate.points, candidate.triangles)
    for algorithm in ALGORITHMS:
        try:
            nodes, cells = fill(candidate.points, candidate.triangles, algorithm)
            _check(nodes, cells, enclosed, wanted, max_volume_change)
        except Refused as refused:
            complaints.append(refused.message.rstrip("."))
            continue
        table = quality.table(nodes, cells)
        return TetMesh(nodes, cells, {"ridge_deg": candidate.ridge_deg, "algorithm": algorithm, **table})
    return None


def _check(nodes, cells, enclosed: float, wanted: float, max_volume_change: float) -> None:
    """Raise when the tetrahedra are not a valid mesh of the wanted body."""
    volumes = quality.volumes(nodes, cells)
    if volumes.min() <= 0:
        raise Refused("meshing_failed", f"{(volumes <= 0).sum()} tetrahedra are flat or turned inside out")
    if abs(volumes.sum() - enclosed) > 1e-9 * enclosed:
        raise Refused("meshing_failed", "the tetrahedra do not fill the surface")
    if quality.parts(cells, len(nodes)) != 1:
        raise Refused("meshing_failed", "the tetrahedra fall apart")
    change = abs(volumes.sum() / wanted - 1.0)
    if change > max_volume_change:
        raise Refused("meshing_failed", f"remaking the surface changed the volume by {100 * change:.2g} %")


def _smallest_angle_deg(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the smallest angle of every triangle in degrees, (F,)."""
    a, b, c = surfaces.edge_lengths(points, triangles).T
    twice = 2 * surfaces.normals_and_areas(points, triangles)[1]
    # The sine of an angle is twice the area over the product of its sides; the smallest has the longest sides.
    largest_product = np.maximum(np.maximum(a * b, b * c), c * a)
    return np.degrees(np.arcsin(np.clip(twice / np.maximum(largest_product, 1e-300), 0.0, 1.0)))
