"""Hollow bodies: the outside stays triangle for triangle, ``S(P) <= t · s_min`` is taken away.

``S`` is the signed distance, ``s_min`` its value at the deepest point, found below the grid's resolution. The
wall is ``t |s_min|`` thick everywhere and the cavity reaches ``(1 - t) |s_min|`` from its deepest point. The
distance is sampled anew on a grid around the cavity, whose spacing follows from that reach and from the body's
extent: the cavity's surface is as good for a thin bowl as for a thick block, and the same however the body lies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry import LONGEST_SIDE, Mesh, repair, surfaces
from vibraverse.geometry.distance.boxes import contains
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.grids import cell_centres
from vibraverse.geometry.meshing.remesh import remesh
from vibraverse.geometry.moments import principal_axes

#: The cavity's reach should be this many samples; they are no closer than the grid's by more than this factor.
_SAMPLES, _FINEST = 3.0, 4.0
#: With fewer samples than this the cavity is not resolved.
_FEWEST = 1.5
#: Width of the Gaussian, in samples, that takes away blades and lace too thin for the samples. It leaves the
#: distance unchanged where that is linear, which is all but the cavity's edges.
_SMOOTHING = 0.6
#: A cavity ends where it would reach less than this many samples, more when its surface cannot be remade otherwise; how
#: deep the body is nearby is looked for so many samples around, and blurred over so many.
_BLADES, _NEARBY, _BLURRED = (0.75, 1.0, 1.5, 2.0, 3.0), 3, 2
#: A level set with more triangles than this is a blade: each try takes long, so every other is left out. A cavity is
#: handed on with at most so many triangles, remade or, where that cannot be, as it is.
_LARGE, _LARGEST = 300_000, 100_000
#: A cavity smaller than a ball of this many samples' radius is a speck.
_SPECK = 1.5
#: Before a level set is remade, triangles go where that moves it by at most this many samples; of these the first with
#: which it does not cut itself.
_FLAT = (0.1, 0.05, 0.02)
#: Edge length wanted on the cavity's surface, in normalised units.
_SIZE = 0.06
#: The deepest point is sought in so many cells at a time, down to cells of this size.
_CELLS, _RESOLVED = 1024, 1e-5
_LEAVE_OUT = "Leave the hollow body of this object out, or raise grids.fine."
#: The cavity must keep this share of the wall after its surface was remade.
_CLEARANCE = 0.6


@dataclass(frozen=True)
class HollowBody:
    """Surface of a hollow body: the outside's vertices and faces first, then the cavities' (oriented inwards).

    ``s_min`` is the signed distance at ``deepest``; ``cavities`` lists the volume of each cavity; ``specks``
    counts those too small to mesh, which stay filled. ``asked`` is the volume of ``S <= t · s_min`` on the samples:
    where walls are about twice ``t |s_min|`` thick, the cavities are less.
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
        """The share of the volume asked for that the cavities have."""
        return sum(self.cavities) / self.asked


@dataclass(frozen=True)
class _Samples:
    """Values on a lattice of its own: ``values[i, j, k]`` at ``origin + spacing · axes @ (i, j, k)``."""

    values: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    spacing: float

    def position(self, indices: np.ndarray) -> np.ndarray:
        """Return where in space ``indices`` (N, 3), whole or not, are: (N, 3)."""
        return self.origin + self.spacing * indices @ self.axes.T


def hollow(
    vertices: np.ndarray, faces: np.ndarray, distance: np.ndarray, t: float, min_kept: float = 0.0
) -> HollowBody:
    """Take ``S(P) <= t · s_min`` out of a solid body.

    ``vertices`` and ``faces`` are its closed surface inside [-1, 1]³, ``distance`` (n, n, n) the signed distance at
    cell centres, ``0 < t < 1``. Raises :class:`Refused` with reason ``too_thin`` when the cavity cannot be resolved, or
    has less than the share ``min_kept`` of the volume asked for.
    """
    closest = ClosestPoint(vertices, faces)
    s_min, deepest = deepest_point((vertices, faces), closest, distance)
    level, reach = t * s_min, (1 - t) * -s_min
    cell = 2.0 / distance.shape[0]
    spacing = max(cell / _FINEST, min(_coarsest(vertices, faces, cell), reach / _SAMPLES))
    if reach < _FEWEST * spacing:
        raise Refused(
            "too_thin",
            f"The body is {-2 * s_min:.4f} thick where it is thickest (longest side 1.8), and "
            f"a cavity of {2 * reach:.4f} cannot be resolved at {spacing:.4f}.",
            _LEAVE_OUT,
        )
    samples = _sampled((vertices, faces), closest, distance, level, spacing)
    # A sample within half a spacing of the level has a part of its cell on either side.
    asked = float(np.clip((level - samples.values) / spacing + 0.5, 0.0, 1.0).sum() * spacing**3)
    cavity, tidied, specks = None, None, 0
    blades = iter(_BLADES)
    for blade in blades:
        shells = repair.parts(*_isosurface(samples, level, blade))
        kept = [
            shell for shell in shells if surfaces.volume(*shell) > 4 / 3 * np.pi * (_SPECK * spacing) ** 3
        ]
        if not kept:
            break
        cavity, specks = surfaces.joined(kept), len(shells) - len(kept)
        tidied = _tidied(cavity, closest, -level, spacing)
        if tidied is not None:
            cavity = tidied
            break
        if len(cavity[1]) > _LARGE:
            next(blades, None)
    if cavity is not None and tidied is None and len(cavity[1]) > _LARGEST:
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
    """Return the least signed distance inside a closed surface and the point where it is.

    ``closest`` finds points of the surface, ``distance`` (n, n, n) is the signed distance at cell centres of [-1, 1]³.
    Depth changes no faster than position, so a cell whose centre is shallower than the deepest point known by more than
    half its diagonal cannot hold a deeper one. The others are halved, the deepest first where they are very many, until
    they are smaller than 1e-5. (Going uphill instead ends on the first crease of the depth.) Raises :class:`Refused`
    with reason ``too_thin`` when no sample is inside.
    """
    n = distance.shape[0]
    if distance.min() >= 0:
        raise Refused("too_thin", "The body holds no sample of the distance grid.", _LEAVE_OUT)
    half = 1.0 / n
    near = np.argwhere(distance <= min(distance.min() + np.sqrt(3) * half, 0.0))
    centres, depth = cell_centres(n)[near], -distance[tuple(near.T)].astype(np.float64)
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    best, where = -1.0, centres[0]
    while half > _RESOLVED:
        chosen = np.argsort(-depth, kind="stable")[:_CELLS]
        parents = np.repeat(depth[chosen], len(corners))
        centres = (centres[chosen, None] + half * corners).reshape(-1, 3)
        depth, half = closest.distance(centres), half / 2
        # Nothing outside is within a point's depth of it.
        unsure = parents <= np.sqrt(3) * half
        if unsure.any():
            depth[unsure] *= np.where(contains(*surface, centres[unsure]), 1.0, -1.0)
        if depth.max() > best:
            best, where = float(depth.max()), centres[depth.argmax()]
        # Around the centre of a ball all are shallower by just so much, and rounding may say more.
        promising = depth > min(best - np.sqrt(3) * half, np.nextafter(depth.max(), -1))
        centres, depth = centres[promising], depth[promising]
    return -best, where


def _coarsest(vertices: np.ndarray, faces: np.ndarray, cell: float) -> float:
    """Return the largest spacing of samples, the same in proportion to the body however it lies.

    It is the grid's for a cube, whose corners are as far from its middle as they can be with sides of that length.
    """
    corners = vertices[faces]
    _, areas = surfaces.normals_and_areas(vertices, faces)
    middle = areas @ corners.mean(axis=1) / areas.sum()
    farthest = np.linalg.norm(vertices - middle, axis=1).max()
    return float(cell * min(1.0, farthest / (np.sqrt(3) * LONGEST_SIDE / 2)))


def _sampled(
    surface: Mesh, closest: ClosestPoint, distance: np.ndarray, level: float, spacing: float
) -> _Samples:
    """Return samples of the signed distance around the cavity, along the body's principal axes.

    Only samples near the level are measured; the others are interpolated from the grid's, which decides on which side
    of the level they are and no more.
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
    """Return the samples raised above any level that the body nearby undercuts by less than ``least``.

    Where a wall is about as thick as the level set asks for, the set is a blade full of holes. Here it ends
    instead. In thick parts nothing changes, since a few samples further in the body is deeper than that.
    """
    from scipy.ndimage import gaussian_filter, generate_binary_structure, minimum_filter

    # A cube and octahedra one after the other are about round, at the cost of their few points.
    nearby = minimum_filter(samples, 3, mode="nearest")
    for _ in range(_NEARBY - 1):
        nearby = minimum_filter(nearby, footprint=generate_binary_structure(3, 1), mode="nearest")
    return np.maximum(samples, gaussian_filter(nearby, _BLURRED, mode="nearest") + least)


def _isosurface(samples: _Samples, level: float, blade: float) -> Mesh:
    """Return the closed surface on which the samples equal ``level``, oriented away from lower values.

    It ends where it would reach less than ``blade`` samples.
    """
    from scipy.ndimage import gaussian_filter
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    # A layer of high values closes the surface; a sample exactly at the level would give faces without area.
    values = gaussian_filter(_opened(samples.values, blade * samples.spacing), _SMOOTHING, mode="nearest")
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


def _thinned(cavity: Mesh, spacing: float) -> Mesh:
    """Return the cavity's surface with fewer triangles where that hardly moves it and it does not cut itself then."""
    for flat in _FLAT:
        thinned = repair.simplify(*cavity, flat * spacing)
        if not crossing_faces(*thinned).any():
            return thinned
    return cavity


def _tidied(cavity: Mesh, closest: ClosestPoint, wall: float, spacing: float) -> Mesh | None:
    """Return the cavity's surface with fewer, better triangles that keep clear of the outside and of each other.

    No edge is kept sharp, because those of a level set are ragged. Returns None when sheets of it are too close.
    """
    cavity = _thinned(cavity, spacing)
    components = surfaces.topology(cavity[1], len(cavity[0])).components
    try:
        points, triangles = remesh(
            *cavity,
            max(4 * spacing, _SIZE),
            min(0.5 * spacing, 0.15 * wall),
            ridge_deg=180.0,
            most=_LARGEST,
        )
    except RuntimeError:
        return None
    nearest = closest.distance(np.concatenate([points, points[triangles].mean(axis=1)])).min()
    if nearest <= _CLEARANCE * wall or surfaces.topology(triangles, len(points)).components != components:
        return None
    return points, triangles
