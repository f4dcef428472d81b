"""Remesh a closed surface to a wanted triangle size without losing its shape or its volume.

Triangles inscribed in a curved surface lose volume, and a body's frequencies follow: an inscribed sphere rings
too high. So the surface is remade in two steps. Mmg keeps the ridges that it is told
(:mod:`vibraverse.geometry.meshing.ridges`) and makes well-shaped triangles within a bounded distance of the
surface. Then the vertices move so that every triangle lies half inside and half outside the original: the mean
height ``h_f`` of the original above face ``f`` is measured at three points, and each vertex takes the
displacement ``u`` that minimises ``Σ_f A_f (n_f·u - h_f)² + ε Σ_f A_f |u|²`` over its faces. Planes and ridges
stay where they are because the original has no height above their faces. What volume is then still missing
comes from the vertices that moved, along their normals and in proportion.

What Mmg makes of a surface depends on the triangles it starts from: where a third of the edges of a bell are split it
leaves a quarter more triangles of the same wanted size. So a body's surface is first :class:`Evened`: remade at half
the size, whereby its own triangles are forgotten. From there it is remade at every size that is tried.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from vibraverse.geometry import Mesh, repair
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.meshing.ridges import ridges
from vibraverse.geometry.surfaces import (
    area,
    edge_lengths,
    edge_numbers,
    fans,
    normals_and_areas,
    steps_to_heights,
    topology,
    vertex_normals,
    volume,
)

#: Sample points inside a triangle whose mean is exact for quadratic heights.
_SAMPLES = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0
#: Weight ε that keeps a vertex from sliding along its surface.
_STIFFNESS = 0.05
_ROUNDS = 3
#: How often a surface is remade with smaller triangles where it cuts itself or is too far from the original: farther
#: than this many times the deviation, or than this share of the mean thickness 2V/A. Mmg promises less, but leaves a
#: blemish now and then where a wall is curved, and half a wall's thickness in one place is 3 % of a frequency.
_MENDED, _BROKEN, _BLEMISH = 5, 2.0, 0.25
#: A surface that does not cut itself is not mended at the cost of more than this many times its triangles.
_DEARER = 3.0
#: Sheets that meet in more than this share of the faces are no local matter.
_LOCAL = 0.02
#: Where the surface bends, triangles may shrink to this share of the wanted size.
_SHRINK = 0.3
#: Ridges that extend less than this share of the wanted size are smoothed.
_SHORTEST = 0.5
#: A surface is evened at this share of the size and the deviation wanted.
_EVEN = 0.5
#: Edges longer than this many sizes are split before, so that sizes given at vertices can vary along them; and because
#: Mmg's idea of the surface is a curved patch on every triangle, which bulges beside creases by a share of its length.
_LONG = 2.0


class SheetsMeet(RuntimeError):
    """Two sheets of a remade surface cut or touch each other: the triangles are too large for the gap between."""


class Evened:
    """A closed surface (V, 3), (F, 3) with even triangles of half a ``size``, to be remade at about that size.

    Where sheets are so close that it would cut itself the triangles are smaller, or in the end those of the original.
    Ridges, where the normal of the original turns by more than ``ridge_deg`` along at least half a size, stay sharp.
    ``sizing(points, size)`` gives the edge lengths (P,) wanted at points (P, 3) when they are ``size`` far from where
    the body needs smaller ones; ``deviation`` bounds the distance from the original. It has at most ``most`` triangles,
    and so has what is remade of it. Raises ``RuntimeError`` when Mmg fails.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        size: float,
        sizing: Callable[[np.ndarray, float], np.ndarray],
        deviation: float,
        ridge_deg: float,
        most: float = np.inf,
    ):
        self.size, self._sizing, self._most = size, sizing, most
        self._closest, self._body = ClosestPoint(vertices, faces), (vertices, faces)
        vertices, faces = repair.split(vertices, faces, _LONG * size)
        sharp = ridges(vertices, faces, ridge_deg, _SHORTEST * size)
        self._start = vertices, faces, sharp
        with suppress(SheetsMeet):
            sizes = _EVEN * sizing(vertices, size)
            self._start = _mended(self._start, sizes, _EVEN * deviation, most=most)

    def remade(self, size: float, deviation: float, yielding: bool = False) -> Mesh:
        """Return the surface as :func:`remesh` does, with edges of the lengths wanted for a size.

        ``yielding``: what the fit makes cut itself stays where Mmg put it, near the original but not fitted to it.
        """
        local = self._sizing(self._start[0], size)
        return _remade(self._closest, self._body, self._start, local, deviation, self._most, yielding)


def remesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    size: float,
    deviation: float,
    ridge_deg: float = 35.0,
    most: float = np.inf,
) -> Mesh:
    """Return the closed surface remade with edges of about ``size``, of the same volume, not cutting itself.

    ``deviation`` bounds the distance from the original: where the surface bends, triangles shrink until they keep it.
    Ridges, where the normal turns by more than ``ridge_deg`` along at least about half a size, stay sharp. Where two
    sheets are so close that the remade ones cut each other, these are remade finer. The fit leaves vertices in place
    that it would take farther from the original than the faces may be. Raises :class:`SheetsMeet` when sheets still
    meet in the end or it would take more than ``most`` triangles, ``RuntimeError`` when Mmg fails.
    """
    closest, body = ClosestPoint(vertices, faces), (vertices, faces)
    vertices, faces = repair.split(vertices, faces, _LONG * size)
    start = vertices, faces, ridges(vertices, faces, ridge_deg, _SHORTEST * size)
    return _remade(closest, body, start, np.full(len(vertices), float(size)), deviation, most, tied=True)


def _remade(
    closest: ClosestPoint,
    body: Mesh,
    start: tuple,
    local: np.ndarray,
    deviation: float,
    most: float,
    yielding: bool = False,
    tied: bool = False,
) -> Mesh:
    """Remake the surface ``start`` with edges of ``local`` (V,) and fit it to that of ``body``.

    ``closest`` finds points of the latter. ``tied``: the fit takes no vertex farther from it than is tolerated.
    """
    wanted = volume(*body)
    tolerated = min(_BROKEN * deviation, _BLEMISH * 2 * wanted / area(*body))

    def fit(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fitted = _fitted(closest, wanted, points, triangles, tolerated if tied else np.inf)
        if yielding:
            fitted = _yielded(points, fitted, triangles)
        return fitted, closest.distance(_samples(fitted, triangles)).reshape(-1, 3).max(axis=1) > tolerated

    return _mended(start, local, deviation, fit, most)[:2]


def _mended(
    start: tuple, local: np.ndarray, deviation: float, fit: Callable | None = None, most: float = np.inf
) -> tuple:
    """Return what Mmg makes of ``start``, finer where that cuts itself or leaves the original, and its ridges.

    ``start`` is vertices (V, 3), faces (F, 3) and ridges (E, 2). ``fit`` returns where the vertices should be and which
    faces (F,) are then too far from the original; if some stay so they are tolerated. Raises :class:`SheetsMeet` when
    the surface still cuts itself in the end, or does so until it has more than ``most`` triangles.
    """
    vertices, faces, sharp = start
    found = None
    for _ in range(_MENDED):
        try:
            _bounded(_fewest(vertices, faces, local), most)
            points, triangles, edges = _mmg(vertices, faces, local, deviation, sharp)
            _bounded(len(triangles), most)
        except RuntimeError:
            if found is None:
                raise
            break
        spoilt = far = _spoilt(points, triangles)
        if fit is not None and not spoilt.any():
            points, far = fit(points, triangles)
            spoilt = crossing_faces(points, triangles)
        if not spoilt.any():
            found, spoilt = (points, triangles, edges), far
            most = min(most, _DEARER * len(triangles))
            if not far.any():
                break
        coarser, local = local, _finer(vertices, local, points, triangles[spoilt])
        if spoilt.mean() > _LOCAL or np.array_equal(coarser, local):
            break
    if found is None:
        raise SheetsMeet(f"{int(spoilt.sum())} faces of the remade surface cut or touch each other")
    return found


def _bounded(count: float, most: float) -> None:
    """Raise :class:`SheetsMeet` when a surface has more than ``most`` triangles."""
    if count > most:
        raise SheetsMeet(f"the remade surface would have {count:.0f} triangles")


def _fewest(vertices: np.ndarray, faces: np.ndarray, sizes: np.ndarray) -> float:
    """Return how many equilateral triangles of the wanted sizes (V,) there would be; Mmg makes about twice as many."""
    areas = normals_and_areas(vertices, faces)[1]
    return float((areas / (np.sqrt(3) / 4 * sizes[faces].mean(axis=1) ** 2)).sum())


def _yielded(points: np.ndarray, fitted: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the fitted points (P, 3), but those of faces that cut each other where they were."""
    for _ in range(_MENDED):
        crossing = crossing_faces(fitted, triangles)
        if not crossing.any():
            break
        fitted = fitted.copy()
        back = np.unique(triangles[crossing])
        fitted[back] = points[back]
    return fitted


def _spoilt(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the faces (F,) that cut another one, or touch another at an edge or a point of their own."""
    if topology(triangles, len(points)).closed_manifold:
        return crossing_faces(points, triangles)
    edge, count = edge_numbers(triangles)
    torn = (count[edge] != 2).reshape(-1, 3).any(axis=1)
    # Fans share no edge: a vertex with two of them is where the surface pinches itself.
    around = np.bincount(fans(triangles, edge)[1], minlength=len(points))
    return torn | (around[triangles] > 1).any(axis=1)


def _mmg(
    vertices: np.ndarray, faces: np.ndarray, sizes: np.ndarray, deviation: float, sharp: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run Mmg's surface remesher with a wanted size (V,) at every vertex and edges (E, 2) to keep sharp.

    Returns vertices, triangles and what became of those edges.
    """
    from mmgpy import MmgMeshS

    mesh = MmgMeshS()
    mesh.set_mesh_size(len(vertices), len(faces), len(sharp))
    mesh.set_vertices(np.ascontiguousarray(vertices, dtype=np.float64))
    mesh.set_triangles(np.ascontiguousarray(faces, dtype=np.int32))
    if len(sharp):
        mesh.set_edges(np.ascontiguousarray(sharp, dtype=np.int32))
        mesh.set_ridge_edges(np.arange(len(sharp), dtype=np.int32))
    mesh["metric"] = np.ascontiguousarray(sizes)[:, None]
    mesh.remesh(
        hmax=float(sizes.max()),
        hmin=_SHRINK * float(sizes.min()),
        hausd=deviation,
        hgrad=1.4,
        ar=180.0,  # Mmg would look for ridges of its own
        verbose=-1,
    )
    edges = mesh.get_edges().astype(np.int64) if len(sharp) else np.zeros((0, 2), np.int64)
    return mesh.get_vertices().copy(), mesh.get_triangles().astype(np.int64), edges


def _finer(vertices: np.ndarray, sizes: np.ndarray, points: np.ndarray, crossing: np.ndarray) -> np.ndarray:
    """Return the wanted sizes (V,), around the faces that cross (C, 3) at most half of what these have."""
    from scipy.spatial import cKDTree

    lengths = edge_lengths(points, crossing)
    distance, nearest = cKDTree(points[crossing].mean(axis=1)).query(vertices)
    around = distance < 1.5 * lengths.max(axis=1)[nearest] + 1e-9
    return np.where(around, np.minimum(sizes, 0.5 * lengths.mean(axis=1)[nearest]), sizes)


def _fitted(
    closest: ClosestPoint, wanted: float, points: np.ndarray, triangles: np.ndarray, tied: float
) -> np.ndarray:
    """Return ``points`` moved so that ``triangles`` deviate from the original evenly, with its volume.

    ``closest`` finds points of the original surface, ``wanted`` is its volume; ``points`` (P, 3) are near it. Those
    taken farther away from it, and farther than ``tied``, stay: along an edge that is sharper than the triangles are
    small the fit makes up for lost volume with single vertices that stick out, for better or worse.
    """
    nearest = closest(points)
    bound = np.maximum(np.linalg.norm(nearest - points, axis=1), tied)
    fitted = move(points, nearest - points, triangles)
    for _ in range(_ROUNDS):
        fitted = move(fitted, _displacements(fitted, triangles, closest), triangles)
        if tied < np.inf:
            strayed = closest.distance(fitted) > bound
            fitted[strayed] = points[strayed]
    return _match_volume(fitted, np.linalg.norm(fitted - points, axis=1), triangles, wanted)


def _displacements(points: np.ndarray, triangles: np.ndarray, closest: ClosestPoint) -> np.ndarray:
    """Return the least-squares displacement of every vertex, (P, 3)."""
    normals, _ = normals_and_areas(points, triangles)
    samples = _samples(points, triangles)
    offsets = (closest(samples) - samples).reshape(-1, len(_SAMPLES), 3)
    heights = np.einsum("fsd,fd->f", offsets, normals) / len(_SAMPLES)
    return steps_to_heights(points, triangles, heights, _STIFFNESS)


def _samples(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return three points of every triangle, (3F, 3)."""
    return np.einsum("sc,fcd->fsd", _SAMPLES, points[triangles]).reshape(-1, 3)


def move(points: np.ndarray, step: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return ``points + step``, with a step left out where it would be long or turn a face over."""
    shortest = np.full(len(points), np.inf)
    np.minimum.at(shortest, triangles.ravel(), np.repeat(edge_lengths(points, triangles).min(axis=1), 3))
    length = np.linalg.norm(step, axis=1)
    step = step * np.minimum(1.0, 0.3 * shortest / np.maximum(length, 1e-300))[:, None]
    before = normals_and_areas(points, triangles)[0]
    for _ in range(10):
        after = normals_and_areas(points + step, triangles)[0]
        turned = np.einsum("ij,ij->i", before, after) < 0.7
        if not turned.any():
            break
        step = step.copy()
        step[np.unique(triangles[turned])] = 0.0
    return points + step


def _match_volume(points: np.ndarray, moved: np.ndarray, triangles: np.ndarray, wanted: float) -> np.ndarray:
    """Return the points moved along their normals for the ``wanted`` volume, in proportion to ``moved`` (P,).

    What the fit left in place, planes above all, stays in place.
    """
    for _ in range(8):
        step = moved[:, None] * vertex_normals(points, triangles)
        missing = wanted - volume(points, triangles)
        # The volume is a cubic in the length of the step; a tenth of the fit's steps is small enough for a slope.
        slope = 10.0 * (volume(points + 0.1 * step, triangles) - volume(points, triangles))
        if abs(missing) <= 1e-14 * wanted or abs(slope) <= 1e-9 * wanted:
            break
        points = move(points, float(np.clip(missing / slope, -0.5, 0.5)) * step, triangles)
    return points
