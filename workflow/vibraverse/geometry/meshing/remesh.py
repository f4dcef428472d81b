"""Remeshing of a closed surface to a wanted triangle size, preserving its shape and its volume.

Triangles inscribed in a curved surface lose volume, and that shifts the frequencies: an inscribed sphere rings too
high. So remeshing has two steps. Mmg keeps the given ridges (:mod:`vibraverse.geometry.meshing.ridges`) and makes
well-shaped triangles within a bounded distance of the surface. Then the vertices move so that every triangle lies half
inside and half outside the original. The mean height ``h_f`` of the original above face ``f`` is measured at three
points. Each vertex takes the displacement ``u`` that minimises ``Σ_f A_f (n_f·u - h_f)² + ε Σ_f A_f |u|²`` over its
faces. Planes and ridges do not move, because the original has no height above their faces. The vertices that moved
then make up the remaining volume along their normals, in proportion to their motion.

Mmg's result depends on the triangles that it starts from: splitting a third of the edges of a bell gives a quarter more
triangles at the same wanted size. So a body's surface is first remeshed at half the size (:class:`EvenSurface`), which
makes the result independent of the original triangles. Every trial size starts from there.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from vibraverse.geometry import Mesh, repair
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.meshing.ridges import ridges
from vibraverse.geometry.meshing.work import FITTED, Work
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

#: Barycentric sample points in a triangle whose mean is exact for quadratic heights.
_SAMPLE_POINTS = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0
#: Weight ε that keeps a vertex from sliding along its surface.
_STIFFNESS = 0.05
#: Iterations of the fit.
_FIT_ROUNDS = 3
#: Most attempts to remesh a surface, each finer where it cuts itself or is too far from the original: farther than this
#: many times the deviation, or than this share of the mean thickness 2V/A. Mmg promises less, but occasionally leaves a
#: blemish on a curved wall; an error of half the wall's thickness in one place changes a frequency by 3 %.
_MAX_ATTEMPTS, _DEVIATION_LIMIT, _THICKNESS_LIMIT = 5, 2.0, 0.25
#: Further attempts may have at most this many times the triangles of the first surface without self-intersections.
_MAX_COST = 3.0
#: Refinement stops when more than this share of the faces is invalid: the cause is then not local.
_MAX_LOCAL_SHARE = 0.02
#: Triangles may shrink to this share of the wanted size where the surface bends.
_MIN_SHRINK = 0.3
#: Ridges that extend less than this share of the wanted size are not kept sharp.
_MIN_RIDGE_LENGTH = 0.5
#: Size and deviation of an even surface, as a share of those wanted.
_EVEN_SHARE = 0.5
#: Longer input edges, in sizes, are split first. That lets the sizes at the vertices vary along them, and it limits the
#: bulge beside creases: Mmg fits a curved patch to every triangle.
_MAX_INPUT_EDGE = 2.0


class SheetsMeet(RuntimeError):
    """Two sheets of a remeshed surface cut or touch: the triangles are too large for the gap between them."""


class EvenSurface:
    """A closed surface (V, 3), (F, 3) with even triangles of half a ``size``, for remeshing at about that size.

    Triangles are smaller where sheets are so close that the surface would cut itself; if that fails too, the original
    triangles stay. Ridges, where the normal turns by more than ``ridge_deg`` along at least half a size, stay sharp.
    ``sizing(points, size)`` returns the wanted edge lengths (P,) at points (P, 3): ``size``, or less where the body
    needs smaller elements. ``deviation`` bounds the distance from the original. The surface has at most ``most``
    triangles. Remeshing starts from the surface ``start`` (V, 3), (F, 3), a thinned original, if one is given, and
    what it takes is counted in ``work``. Raises ``RuntimeError`` when Mmg fails.
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
        start: Mesh | None = None,
        work: Work | None = None,
    ):
        self.size, self._sizing, self._work = size, sizing, work or Work()
        self._closest, self._body = ClosestPoint(vertices, faces), (vertices, faces)
        vertices, faces = repair.split(*(start or self._body), _MAX_INPUT_EDGE * size)
        sharp = ridges(vertices, faces, ridge_deg, _MIN_RIDGE_LENGTH * size)
        self._start = vertices, faces, sharp
        with suppress(SheetsMeet):
            sizes = _EVEN_SHARE * sizing(vertices, size)
            self._start = _remesh_validly(
                self._start, sizes, _EVEN_SHARE * deviation, most=most, work=self._work
            )

    def remesh(self, size: float, deviation: float, yielding: bool = False, most: float = np.inf) -> Mesh:
        """Return the surface remeshed to the edge lengths that ``sizing`` wants for a size.

        With ``yielding``, vertices whose fit causes self-intersections stay where Mmg put them: near the original, but
        not fitted to it. Raises as the function :func:`remesh`.
        """
        local = self._sizing(self._start[0], size)
        return _remesh_and_fit(
            self._closest, self._body, self._start, local, deviation, most, yielding, work=self._work
        )


def remesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    size: float,
    deviation: float,
    ridge_deg: float = 35.0,
    most: float = np.inf,
) -> Mesh:
    """Remesh a closed surface with edges of about ``size``, the same volume and no self-intersections.

    ``deviation`` bounds the distance from the original: triangles shrink where the surface bends. Ridges, where the
    normal turns by more than ``ridge_deg`` along at least half a size, stay sharp. Sheets that would cut each other are
    refined. The fit moves no vertex farther from the original than faces may be. Raises :class:`SheetsMeet` when sheets
    still meet in the end or more than ``most`` triangles are needed, ``RuntimeError`` when Mmg fails.
    """
    closest, body = ClosestPoint(vertices, faces), (vertices, faces)
    vertices, faces = repair.split(vertices, faces, _MAX_INPUT_EDGE * size)
    start = vertices, faces, ridges(vertices, faces, ridge_deg, _MIN_RIDGE_LENGTH * size)
    return _remesh_and_fit(
        closest, body, start, np.full(len(vertices), float(size)), deviation, most, tied=True
    )


def _remesh_and_fit(
    closest: ClosestPoint,
    body: Mesh,
    start: tuple,
    local: np.ndarray,
    deviation: float,
    most: float,
    yielding: bool = False,
    tied: bool = False,
    work: Work | None = None,
) -> Mesh:
    """Remesh the surface ``start`` with edge lengths ``local`` (V,) and fit it to the surface of ``body``.

    ``closest`` finds points of the latter. With ``tied``, the fit moves no vertex farther from it than is tolerated.
    """
    wanted = volume(*body)
    tolerated = min(_DEVIATION_LIMIT * deviation, _THICKNESS_LIMIT * 2 * wanted / area(*body))

    def fit(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        fitted = fit_to(closest, wanted, points, triangles, tolerated if tied else np.inf)
        if yielding:
            fitted = _yield(points, fitted, triangles)
        return fitted, closest.distance(_samples(fitted, triangles)).reshape(-1, 3).max(axis=1) > tolerated

    return _remesh_validly(start, local, deviation, fit, most, work)[:2]


def _remesh_validly(
    start: tuple,
    local: np.ndarray,
    deviation: float,
    fit: Callable | None = None,
    most: float = np.inf,
    work: Work | None = None,
) -> tuple:
    """Remesh ``start``, finer where the result cuts itself or leaves the original; return it with its ridges.

    ``start`` is vertices (V, 3), faces (F, 3) and ridges (E, 2). ``fit`` returns the fitted vertices and which faces
    (F,) are then too far from the original; some may stay so after the last attempt. Raises :class:`SheetsMeet` when
    no attempt with at most ``most`` triangles is free of self-intersections, and :class:`Spent` when there is none
    within the limit of ``work``.
    """
    vertices, faces, sharp = start
    found, work = None, work or Work()
    for _ in range(_MAX_ATTEMPTS):
        try:
            work.check()
            _check_count(_min_triangles(vertices, faces, local), most)
            points, triangles, edges = _mmg(vertices, faces, local, deviation, sharp)
            work.add(len(faces) + len(triangles))
            _check_count(len(triangles), most)
        except RuntimeError:
            if found is None:
                raise
            break
        invalid = far = _invalid_faces(points, triangles)
        if fit is not None and not invalid.any():
            work.add(len(triangles), FITTED)
            points, far = fit(points, triangles)
            invalid = crossing_faces(points, triangles)
        if not invalid.any():
            found, invalid = (points, triangles, edges), far
            most = min(most, _MAX_COST * len(triangles))
            if not far.any():
                break
        coarser, local = local, _refined(vertices, local, points, triangles[invalid])
        if invalid.mean() > _MAX_LOCAL_SHARE or np.array_equal(coarser, local):
            break
    if found is None:
        raise SheetsMeet(f"{int(invalid.sum())} faces of the remeshed surface cut or touch each other")
    return found


def _check_count(count: float, most: float) -> None:
    """Raise :class:`SheetsMeet` when a surface has more than ``most`` triangles."""
    if count > most:
        raise SheetsMeet(f"the remeshed surface would have {count:.0f} triangles")


def _min_triangles(vertices: np.ndarray, faces: np.ndarray, sizes: np.ndarray) -> float:
    """Return the number of equilateral triangles of the wanted sizes (V,); Mmg makes about twice as many."""
    areas = normals_and_areas(vertices, faces)[1]
    return float((areas / (np.sqrt(3) / 4 * sizes[faces].mean(axis=1) ** 2)).sum())


def _yield(points: np.ndarray, fitted: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the fitted points (P, 3), with those of faces that cut each other moved back."""
    for _ in range(_MAX_ATTEMPTS):
        crossing = crossing_faces(fitted, triangles)
        if not crossing.any():
            break
        fitted = fitted.copy()
        back = np.unique(triangles[crossing])
        fitted[back] = points[back]
    return fitted


def _invalid_faces(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return which faces (F,) cut another one, or touch another one at an edge or a point of their own."""
    if topology(triangles, len(points)).closed_manifold:
        return crossing_faces(points, triangles)
    edge, count = edge_numbers(triangles)
    torn = (count[edge] != 2).reshape(-1, 3).any(axis=1)
    # Fans share no edge, so the surface is pinched at a vertex with two of them.
    around = np.bincount(fans(triangles, edge)[1], minlength=len(points))
    return torn | (around[triangles] > 1).any(axis=1)


def _mmg(
    vertices: np.ndarray, faces: np.ndarray, sizes: np.ndarray, deviation: float, sharp: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run Mmg's surface remesher with wanted sizes (V,) at the vertices and edges (E, 2) that stay sharp.

    Returns vertices, triangles and the sharp edges of the result.
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
        hmin=_MIN_SHRINK * float(sizes.min()),
        hausd=deviation,
        hgrad=1.4,
        ar=180.0,  # switches off Mmg's own search for ridges
        verbose=-1,
    )
    edges = mesh.get_edges().astype(np.int64) if len(sharp) else np.zeros((0, 2), np.int64)
    return mesh.get_vertices().copy(), mesh.get_triangles().astype(np.int64), edges


def _refined(vertices: np.ndarray, sizes: np.ndarray, points: np.ndarray, crossing: np.ndarray) -> np.ndarray:
    """Return the wanted sizes (V,), at most half the edge lengths of the crossing faces (C, 3) around these."""
    from scipy.spatial import cKDTree

    lengths = edge_lengths(points, crossing)
    distance, nearest = cKDTree(points[crossing].mean(axis=1)).query(vertices)
    around = distance < 1.5 * lengths.max(axis=1)[nearest] + 1e-9
    return np.where(around, np.minimum(sizes, 0.5 * lengths.mean(axis=1)[nearest]), sizes)


def fit_to(
    closest: ClosestPoint, wanted: float, points: np.ndarray, triangles: np.ndarray, tied: float
) -> np.ndarray:
    """Return ``points`` moved so that ``triangles`` deviate from the original evenly and enclose its volume.

    ``closest`` finds points of the original surface, ``wanted`` is its volume; ``points`` (P, 3) are near it. A point
    does not move if that takes it farther from the surface, and farther than ``tied``: along edges too sharp for the
    triangles, the fit would make up for lost volume with single vertices that stick out.
    """
    nearest = closest(points)
    bound = np.maximum(np.linalg.norm(nearest - points, axis=1), tied)
    fitted = move(points, nearest - points, triangles)
    for _ in range(_FIT_ROUNDS):
        fitted = move(fitted, _displacements(fitted, triangles, closest), triangles)
        if tied < np.inf:
            strayed = closest.distance(fitted) > bound
            fitted[strayed] = points[strayed]
    return _match_volume(fitted, np.linalg.norm(fitted - points, axis=1), triangles, wanted)


def _displacements(points: np.ndarray, triangles: np.ndarray, closest: ClosestPoint) -> np.ndarray:
    """Return the least-squares displacement of every vertex, (P, 3)."""
    normals, _ = normals_and_areas(points, triangles)
    samples = _samples(points, triangles)
    offsets = (closest(samples) - samples).reshape(-1, len(_SAMPLE_POINTS), 3)
    heights = np.einsum("fsd,fd->f", offsets, normals) / len(_SAMPLE_POINTS)
    return steps_to_heights(points, triangles, heights, _STIFFNESS)


def _samples(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the three sample points of every triangle, (3F, 3)."""
    return np.einsum("sc,fcd->fsd", _SAMPLE_POINTS, points[triangles]).reshape(-1, 3)


def move(points: np.ndarray, step: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return ``points + step``, with long steps shortened and those that turn a face over left out."""
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

    Points that the fit left in place do not move, above all those of planes.
    """
    for _ in range(8):
        step = moved[:, None] * vertex_normals(points, triangles)
        missing = wanted - volume(points, triangles)
        # The volume is cubic in the step length; a tenth of the fit's steps is small enough for a slope.
        slope = 10.0 * (volume(points + 0.1 * step, triangles) - volume(points, triangles))
        if abs(missing) <= 1e-14 * wanted or abs(slope) <= 1e-9 * wanted:
            break
        points = move(points, float(np.clip(missing / slope, -0.5, 0.5)) * step, triangles)
    return points
