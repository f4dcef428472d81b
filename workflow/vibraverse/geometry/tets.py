"""From a closed surface to tetrahedra: one path for solid and hollow bodies.

The surface is remade at a size that gives about the wanted number of elements, then filled. Whether a shell
inside is a cavity makes no difference anywhere, so meshing can never tell solid from hollow. When filling
fails, the next recipe is tried before the body is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.geometry import quality, surfaces
from vibraverse.geometry.fill import fill
from vibraverse.geometry.remesh import remesh
from vibraverse.refusal import Refused

#: Remeshing options and filling algorithm, the one to prefer first.
RECIPES = (
    ({"deviation": 0.06, "ridge_deg": 25.0}, "delaunay"),
    ({"deviation": 0.03, "ridge_deg": 25.0}, "delaunay"),
    ({"deviation": 0.06, "ridge_deg": 50.0}, "delaunay"),
    ({"deviation": 0.02, "ridge_deg": 12.0}, "delaunay"),
    ({"deviation": 0.06, "ridge_deg": 25.0}, "hxt"),
)
#: The element count may miss the target by this factor before the size is tried again.
_TOLERANCE = 1.15
_TRIALS = 4


@dataclass(frozen=True)
class TetMesh:
    """Tetrahedra: ``points`` (N, 3) float64, ``cells`` (T, 4) positively oriented, and a ``quality`` table."""

    points: np.ndarray
    cells: np.ndarray
    quality: dict


def mesh_body(vertices: np.ndarray, faces: np.ndarray, options) -> TetMesh:
    """Run :func:`tetrahedralise` in a child process under ``options.limits`` (see ``vibraverse.config``)."""
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
    vertices: np.ndarray, faces: np.ndarray, target_elements: int = 6000, max_volume_change: float = 0.005
) -> TetMesh:
    """Fill a closed, oriented, manifold surface with about ``target_elements`` tetrahedra.

    Shells inside the outermost one are cavities and are oriented into the body's outside. Raises
    :class:`Refused` with reason ``meshing_failed`` when no recipe gives valid tetrahedra whose volume differs
    from the surface's by at most the factor ``max_volume_change``.
    """
    complaint = ""
    for recipe, algorithm in RECIPES:
        try:
            return _by_recipe(vertices, faces, target_elements, max_volume_change, recipe, algorithm)
        except (Refused, RuntimeError) as error:
            complaint = getattr(error, "message", str(error))
    raise Refused(
        "meshing_failed",
        f"No recipe filled the surface with tetrahedra; the last one said: {complaint}",
        "Repair or simplify the mesh, or raise tets.target_elements.",
    )


def _by_recipe(vertices, faces, target, max_volume_change, recipe, algorithm) -> TetMesh:
    wanted = surfaces.volume(vertices, faces)
    size = _first_size(surfaces.area(vertices, faces), wanted, target)
    best = None
    for _ in range(_TRIALS):
        points, triangles = remesh(vertices, faces, size, **recipe)
        count = len(fill(points, triangles, algorithm, optimise=False)[1])
        miss = abs(np.log(count / target))
        if best is None or miss < best[0]:
            best = miss, points, triangles
        if miss < np.log(_TOLERANCE):
            break
        size *= float(np.clip((count / target) ** 0.45, 0.5, 2.0))
    _, points, triangles = best
    nodes, cells = fill(points, triangles, algorithm)
    _check(nodes, cells, surfaces.volume(points, triangles), wanted, max_volume_change)
    return TetMesh(nodes, cells, quality.table(nodes, cells))


def _first_size(area: float, volume: float, target: int) -> float:
    """Return the edge length at which surface layer and inside together hold ``target`` elements."""
    low, high = 1e-4, 2.0
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if 5 * area / middle**2 + 8 * volume / middle**3 > target else (low, middle)
    return float(high)


def _check(nodes, cells, enclosed: float, wanted: float, max_volume_change: float) -> None:
    """Raise when the tetrahedra are not a valid mesh of the wanted body."""
    volumes = quality.volumes(nodes, cells)
    if volumes.min() <= 0:
        raise Refused("meshing_failed", f"{(volumes <= 0).sum()} tetrahedra are flat or turned inside out.")
    if abs(volumes.sum() - enclosed) > 1e-9 * enclosed:
        raise Refused("meshing_failed", "The tetrahedra do not fill the surface.")
    change = abs(volumes.sum() / wanted - 1.0)
    if change > max_volume_change:
        raise Refused("meshing_failed", f"Remeshing changed the volume by {100 * change:.2g} %.")
