"""Hollow bodies: the cavity is ``S(P) <= t · s_min``, and the outside keeps its triangles.

``S`` is the signed distance and ``s_min`` its value at the deepest point, which is found below the grid's resolution.
The wall is ``t |s_min|`` thick everywhere. The cavity's reach is ``(1 - t) |s_min|``, from its deepest point to its
surface. The distance is sampled again on a grid around the cavity, whose spacing follows from the reach and from the
body's extent. So the cavity's surface is as good for a thin bowl as for a thick block, in any orientation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry import LONGEST_SIDE, Mesh, repair, surfaces
from vibraverse.geometry.distance.boxes import contains
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.meshing.remesh import remesh
from vibraverse.geometry.moments import principal_axes
from vibraverse.geometry.voxels import cell_centres

#: Samples wanted over the cavity's reach, and the largest factor by which they may be finer than the grid.
_REACH_SAMPLES, _MAX_REFINEMENT = 3.0, 4.0
#: A reach of fewer samples than this does not resolve the cavity.
_MIN_REACH_SAMPLES = 1.5
#: Standard deviation in samples of the Gaussian that removes features too thin for the samples. It leaves the
#: distance unchanged where that is linear, that is, everywhere but at the cavity's edges.
_SMOOTHING_WIDTH = 0.6
#: A cavity ends where its reach is below this many samples; the next value is tried when its surface cannot be
#: remeshed. The depth nearby is the minimum over a radius of so many samples, blurred over so many.
_BLADE_DEPTHS, _OPENING_RADIUS, _OPENING_BLUR = (0.75, 1.0, 1.5, 2.0, 3.0), 3, 2
#: Above the first number of triangles an attempt is slow, so every other one is skipped. The second is the largest
#: number that a cavity may have, remeshed or not.
_SLOW_TRIANGLES, _MAX_TRIANGLES = 300_000, 100_000
#: A cavity smaller than a ball of this radius, in samples, is a speck.
_SPECK_RADIUS = 1.5
#: Tolerances of the simplification before remeshing, in samples. The first that causes no self-intersection is
#: taken.
_SIMPLIFY_TOLERANCES = (0.1, 0.05, 0.02)
#: Edge length wanted on the cavity's surface, in normalised units.
_EDGE_LENGTH = 0.06
#: The search for the deepest point keeps at most so many cells and ends at cells of this size.
_MAX_CELLS, _RESOLUTION = 1024, 1e-5
_LEAVE_OUT = "Leave the hollow body of this object out, or raise grids.fine."
#: A remeshed cavity must keep this share of the wall.
_MIN_CLEARANCE = 0.6


@dataclass(frozen=True)
class HollowBody:
    """Surface of a hollow body: vertices and faces of the outside, then those of the cavities, oriented inwards.

    ``s_min`` is the signed distance at ``deepest``; ``cavities`` lists the volume of each cavity; ``specks``
    counts those too small to mesh, which stay filled. ``asked`` is the volume of ``S <= t · s_min`` on the samples.
    The cavities hold less where walls are about twice ``t |s_min|`` thick.
    """

    vertices: np.ndarray
    faces: np.ndarray
    s_min: float
    deepest: np.ndarray
    cavities: list[float]
    specks: int
    asked: float

    @property
    def kept(self) -> float:
        """Volume of the cavities as a share of the volume asked for."""
        return sum(self.cavities) / self.asked


@dataclass(frozen=True)
class _Samples:
    """Values on a rotated lattice: ``values[i, j, k]`` lies at ``origin + spacing · axes @ (i, j, k)``."""

    values: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    spacing: float

    def position(self, indices: np.ndarray) -> np.ndarray:
        """Return the points (N, 3) at lattice ``indices`` (N, 3), which may be fractional."""
        return self.origin + self.spacing * indices @ self.axes.T


def hollow(
    vertices: np.ndarray, faces: np.ndarray, distance: np.ndarray, t: float, min_kept: float = 0.0
) -> HollowBody:
    """Return a solid body without its part ``S(P) <= t · s_min``.

    ``vertices`` and ``faces`` are its closed surface inside [-1, 1]³, ``distance`` (n, n, n) the signed distance at
    cell centres, ``0 < t < 1``. Raises :class:`Refused` with reason ``too_thin`` when the cavity cannot be resolved or
    holds less than the share ``min_kept`` of the volume asked for.
    """
    closest = ClosestPoint(vertices, faces)
    s_min, deepest = deepest_point((vertices, faces), closest, distance)
    level, reach = t * s_min, (1 - t) * -s_min
    cell = 2.0 / distance.shape[0]
    spacing = max(cell / _MAX_REFINEMENT, min(_max_spacing(vertices, faces, cell), reach / _REACH_SAMPLES))
    if reach < _MIN_REACH_SAMPLES * spacing:
        raise Refused(
            "too_thin",
            f"The body is {-2 * s_min:.4f} thick where it is thickest (longest side 1.8), and "
            f"a cavity of {2 * reach:.4f} cannot be resolved at {spacing:.4f}.",
            _LEAVE_OUT,
        )
    samples = _resampled((vertices, faces), closest, distance, level, spacing)
    # The cell of a sample within half a spacing of the level lies partly on either side.
    asked = float(np.clip((level - samples.values) / spacing + 0.5, 0.0, 1.0).sum() * spacing**3)
    cavity, remeshed, specks = None, None, 0
    blades = iter(_BLADE_DEPTHS)
    for blade in blades:
        shells = repair.parts(*_isosurface(samples, level, blade))
        kept = [
            shell
            for shell in shells
            if surfaces.volume(*shell) > 4 / 3 * np.pi * (_SPECK_RADIUS * spacing) ** 3
        ]
        if not kept:
            break
        cavity, specks = surfaces.joined(kept), len(shells) - len(kept)
        remeshed = _remeshed(cavity, closest, -level, spacing)
        if remeshed is not None:
            cavity = remeshed
            break
        if len(cavity[1]) > _SLOW_TRIANGLES:
            next(blades, None)
    if cavity is not None and remeshed is None and len(cavity[1]) > _MAX_TRIANGLES:
        raise Refused(
            "too_thin",
            f"The cavity would be a blade of {len(cavity[1])} triangles, which cannot be remeshed with fewer.",
            _LEAVE_OUT,
        )
    if cavity is None:
        raise Refused("too_thin", "The cavity falls into pieces too small to mesh.", _LEAVE_OUT)
    points, triangles = cavity
    body = HollowBody(
        *surfaces.joined([(vertices, faces), (points, triangles[:, ::-1])]),
        s_min=s_min,
        deepest=deepest,
        cavities=sorted((surfaces.volume(*part) for part in repair.parts(points, triangles)), reverse=True),
        specks=specks,
        asked=asked,
    )
    if body.kept < min_kept:
        raise Refused(
            "too_thin",
            f"Only {100 * body.kept:.0f} % of the cavity that t = {t:.2f} asks for could be made: the walls are hardly "
            "thicker than twice the wanted wall.",
            "Leave the hollow body of this object out, lower hollow.min_kept, or narrow hollow.thickness.",
        )
    return body


def deepest_point(surface: Mesh, closest: ClosestPoint, distance: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the smallest signed distance inside a closed surface and the point that has it.

    ``closest`` finds points of the surface, ``distance`` (n, n, n) is the signed distance at cell centres of [-1, 1]³.
    Branch and bound: depth changes no faster than position. So a cell cannot hold a deeper point than the deepest known
    one when its centre is shallower by more than half its diagonal. The other cells are halved, the deepest first when
    they are many, until they are smaller than 1e-5. (Gradient ascent would end on the first crease of the depth.)
    Raises :class:`Refused` with reason ``too_thin`` when no sample is inside.
    """
    n = distance.shape[0]
    if distance.min() >= 0:
        raise Refused("too_thin", "The body holds no sample of the distance grid.", _LEAVE_OUT)
    half = 1.0 / n
    near = np.argwhere(distance <= min(distance.min() + np.sqrt(3) * half, 0.0))
    centres, depth = cell_centres(n)[near], -distance[tuple(near.T)].astype(np.float64)
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    best, where = -1.0, centres[0]
    while half > _RESOLUTION:
        chosen = np.argsort(-depth, kind="stable")[:_MAX_CELLS]
        parents = np.repeat(depth[chosen], len(corners))
        centres = (centres[chosen, None] + half * corners).reshape(-1, 3)
        depth, half = closest.distance(centres), half / 2
        # A centre may lie outside only if its parent is shallower than the distance between them.
        unsure = parents <= np.sqrt(3) * half
        if unsure.any():
            depth[unsure] *= np.where(contains(*surface, centres[unsure]), 1.0, -1.0)
        if depth.max() > best:
            best, where = float(depth.max()), centres[depth.argmax()]
        # Around the centre of a ball every cell is at this bound, so rounding must not discard them all.
        promising = depth > min(best - np.sqrt(3) * half, np.nextafter(depth.max(), -1))
        centres, depth = centres[promising], depth[promising]
    return -best, where


def _max_spacing(vertices: np.ndarray, faces: np.ndarray, cell: float) -> float:
    """Return the largest spacing of samples, in proportion to the body whatever its orientation.

    A cube gets the spacing of the grid: no body with sides of that length has corners farther from its middle.
    """
    corners = vertices[faces]
    _, areas = surfaces.normals_and_areas(vertices, faces)
    middle = areas @ corners.mean(axis=1) / areas.sum()
    farthest = np.linalg.norm(vertices - middle, axis=1).max()
    return float(cell * min(1.0, farthest / (np.sqrt(3) * LONGEST_SIDE / 2)))


def _resampled(
    surface: Mesh, closest: ClosestPoint, distance: np.ndarray, level: float, spacing: float
) -> _Samples:
    """Return samples of the signed distance around the cavity, along the body's principal axes.

    Only samples near the level are measured. The others are interpolated from the grid: of them, only the side of the
    level matters.
    """
    from scipy.ndimage import affine_transform

    n = distance.shape[0]
    cell = 2.0 / n
    centre, axes = principal_axes(*surface)
    near = (cell_centres(n)[np.argwhere(distance <= level + 2 * cell)] - centre) @ axes / spacing
    low, high = np.floor(near.min(axis=0)) - 1, np.ceil(near.max(axis=0)) + 2
    origin = centre + axes @ (spacing * low)
    values = affine_transform(
        distance.astype(np.float64),
        axes * (spacing / cell),
        (origin - cell_centres(n)[0]) / cell,
        output_shape=tuple((high - low).astype(int)),
        order=1,
        mode="nearest",
    )
    samples = _Samples(values, origin, axes, spacing)
    close = np.argwhere(np.abs(values - level) < 0.75 * cell)
    points = samples.position(close)
    measured = closest.distance(points)
    values[tuple(close.T)] = np.where(contains(*surface, points), -measured, measured)
    return samples


def _opened(samples: np.ndarray, least: float) -> np.ndarray:
    """Return the samples raised to at least the minimum nearby plus ``least``: a morphological opening.

    Where a wall is hardly thicker than the level set asks for, the set is a thin blade full of holes. The opening
    removes it. Thick parts do not change, because the body is deeper a few samples further in.
    """
    from scipy.ndimage import gaussian_filter, generate_binary_structure, minimum_filter

    # A cube followed by octahedra approximates a ball with few points.
    nearby = minimum_filter(samples, 3, mode="nearest")
    for _ in range(_OPENING_RADIUS - 1):
        nearby = minimum_filter(nearby, footprint=generate_binary_structure(3, 1), mode="nearest")
    return np.maximum(samples, gaussian_filter(nearby, _OPENING_BLUR, mode="nearest") + least)


def _isosurface(samples: _Samples, level: float, blade: float) -> Mesh:
    """Return the closed surface on which the samples equal ``level``, oriented away from lower values.

    ``blade`` is the smallest reach of the set inside, in samples; see :func:`_opened`.
    """
    from scipy.ndimage import gaussian_filter
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    # A layer of high values closes the surface. A sample exactly at the level would give faces without area.
    values = gaussian_filter(
        _opened(samples.values, blade * samples.spacing), _SMOOTHING_WIDTH, mode="nearest"
    )
    values = np.pad((values - level) / samples.spacing, 1, constant_values=1.0)
    values = np.where(np.abs(values) < 1e-4, 1e-4, values)
    image = vtkImageData()
    image.SetDimensions(*values.shape)
    image.GetPointData().SetScalars(numpy_to_vtk(values.ravel(order="F"), deep=True))
    contour = vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, 0.0)
    contour.ComputeNormalsOff()
    contour.ComputeScalarsOff()
    contour.Update()
    surface = contour.GetOutput()
    if not surface.GetNumberOfPolys():
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    points = vtk_to_numpy(surface.GetPoints().GetData()).astype(np.float64)
    triangles = vtk_to_numpy(surface.GetPolys().GetConnectivityArray()).reshape(-1, 3).astype(np.int64)
    points, triangles = repair.weld(samples.position(points - 1), triangles)
    return points, repair.orient(points, triangles)


def _simplified(cavity: Mesh, spacing: float) -> Mesh:
    """Return the cavity's surface with fewer triangles, hardly moved and without self-intersections."""
    for flat in _SIMPLIFY_TOLERANCES:
        simplified = repair.simplify(*cavity, flat * spacing)
        if not crossing_faces(*simplified).any():
            return simplified
    return cavity


def _remeshed(cavity: Mesh, closest: ClosestPoint, wall: float, spacing: float) -> Mesh | None:
    """Return the cavity's surface with fewer, better triangles that keep clear of the outside and of each other.

    No edge stays sharp, because the edges of a level set are ragged. Returns None when its sheets are too close.
    """
    cavity = _simplified(cavity, spacing)
    components = surfaces.topology(cavity[1], len(cavity[0])).components
    try:
        points, triangles = remesh(
            *cavity,
            max(4 * spacing, _EDGE_LENGTH),
            min(0.5 * spacing, 0.15 * wall),
            ridge_deg=180.0,
            most=_MAX_TRIANGLES,
        )
    except RuntimeError:
        return None
    nearest = closest.distance(np.concatenate([points, points[triangles].mean(axis=1)])).min()
    if nearest <= _MIN_CLEARANCE * wall or surfaces.topology(triangles, len(points)).components != components:
        return None
    return points, triangles
