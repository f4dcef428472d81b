"""What a reconstructed shape is worth: its surface, and how far it is from the true one.

A reconstruction is a function that gives signed distances at places in [-1, 1]³. Lengths are normalised: the longest
side of the body is 1.8. A share of the length (1 %, 2 %) is one of that side.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label
from scipy.spatial import cKDTree

from vibraverse.contract.seeds import rng
from vibraverse.geometry import LONGEST_SIDE, Mesh, surfaces
from vibraverse.geometry.voxels import cell_centres
from vibraverse.learn import metrics
from vibraverse.learn.baselines.splines import spline_modes, spline_space
from vibraverse.learn.sampling import EVEN, NEAR, ON, UNIT, sample_surface

#: Signed distances (n,) at places (n, 3).
Field = Callable[[np.ndarray], np.ndarray]

#: Distance from the surface within which the error is measured apart.
BAND = 0.05
#: Largest distance that the mean error of all places looks at; what is farther counts as this far.
_FAR = 0.1
#: Values at the samples of a grid are at least this far from the level, as a share of the cells: faces need an area.
_OFF_LEVEL = 1e-4
#: Most points of a surface that are compared.
_POINTS = 16_384


@dataclass(frozen=True)
class Truth:
    """What is known of a body: ``places`` (3, s, 3) as stored, ``distances`` (2, s), surface ``points`` (p, 6)."""

    places: np.ndarray
    distances: np.ndarray
    points: np.ndarray

    @classmethod
    def of(cls, samples, body: int) -> Truth:
        """Return that of a body of the samples."""
        return cls(*(samples.row(name, body) for name in ("distance_places", "distances", "points")))


def extracted(values: np.ndarray) -> Mesh | None:
    """Return the closed surface of the negative values on the cell centres of [-1, 1]³ (n, n, n); None without any.

    Of an inside that falls into pieces, the largest one counts; its cavities stay.
    """
    from skimage.measure import marching_cubes

    pieces, count = label(values < 0)
    if count == 0:
        return None
    largest = np.bincount(pieces.ravel())[1:].argmax() + 1
    n, cell = len(values), 2.0 / len(values)
    values = np.where((values < 0) & (pieces != largest), -values, values)
    off = _OFF_LEVEL * cell
    values = np.where(values < 0, np.minimum(values, -off), np.maximum(values, off))
    # A layer outside closes what reaches the edge of the grid.
    values = np.pad(values, 1, constant_values=cell)
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    return cell * (vertices.astype(np.float64) - 1.0) + cell_centres(n)[0], faces.astype(np.int64)


def on_grid(field: Field, cells: int) -> np.ndarray:
    """Return the values (n, n, n) of a field at the cell centres of [-1, 1]³."""
    axis = cell_centres(cells)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return field(places.reshape(-1, 3)).reshape(cells, cells, cells)


def measured(field: Field, truth: Truth, cells: int, modes: int, poisson: float, unknowns: int) -> dict:
    """Return the measures of a reconstruction, whose surface is extracted on so many cells along an axis.

    ``log_omega`` (m,) are the logarithms of ω for E = ρ = 1 and a Poisson's ratio, by splines of some unknowns, in
    normalised lengths; not numbers where there is no surface, or none that a solid can have. The others are one number
    each; ``empty`` is 1 without a surface, and ``seconds`` the time to find it.
    """
    began = time.perf_counter()
    mesh = extracted(on_grid(field, cells))
    seconds = time.perf_counter() - began
    return {
        **compared_distances(field, truth),
        **compared_surfaces(mesh, truth),
        "log_omega": simulated(mesh, modes, poisson, unknowns),
        "empty": float(mesh is None),
        "seconds": seconds,
    }


def compared_distances(field: Field, truth: Truth) -> dict[str, float]:
    """Return IoU, relative error of the volume, and mean errors of the distance: everywhere, and near the surface.

    IoU and volume count even places inside, and so have a sampling error. Everywhere, distances beyond 0.1 count as
    0.1, which some networks do not learn to exceed.
    """
    even, near = (field(UNIT * truth.places[kind]).astype(np.float64) for kind in (EVEN, NEAR))
    true = truth.distances.astype(np.float64)
    found_inside, inside = even < 0, true[EVEN] < 0
    union, band = (found_inside | inside).sum(), np.abs(true[NEAR]) < BAND
    return {
        "iou": float((found_inside & inside).sum() / union) if union else np.nan,
        "volume_error": float(abs(found_inside.sum() / inside.sum() - 1.0)) if inside.any() else np.nan,
        "distance_error": float(np.abs(np.clip(even, -_FAR, _FAR) - np.clip(true[EVEN], -_FAR, _FAR)).mean()),
        "band_error": float(np.abs(near - true[NEAR])[band].mean()) if band.any() else np.nan,
    }


def compared_surfaces(mesh: Mesh | None, truth: Truth) -> dict[str, float]:
    """Return Chamfer distance, F-scores and normal consistency of a surface; without one, scores of zero.

    The Chamfer distance is the mean of both directions' mean distances. From true points it leads to the triangles;
    from points drawn on these, as many, to the nearest true point. So even the true surface has a Chamfer distance, a
    quarter of the distance of neighbouring points. Normals are those of nearest points, and count without their sign.
    """
    if mesh is None:
        return {"chamfer": np.nan, "normals": 0.0, **{f"f_{share:.0%}": 0.0 for share in metrics.NEAR}}
    from vibraverse.geometry.distance.closest import ClosestPoint

    true = UNIT * truth.places[ON][:_POINTS]
    drawn = sample_surface(*mesh, len(true), rng("drawn on a reconstruction"))
    there, back = ClosestPoint(*mesh).distance(true), cKDTree(true).query(drawn[:, :3])[0]
    found = {"chamfer": 0.5 * (there.mean() + back.mean())}
    for share in metrics.NEAR:
        recall, precision = (float((one < share * LONGEST_SIDE).mean()) for one in (there, back))
        total = recall + precision
        found[f"f_{share:.0%}"] = 2 * recall * precision / total if total else 0.0
    pairs = (drawn, truth.points), (truth.points, drawn)
    alike = [
        np.abs(np.vecdot(one[:, 3:], other[cKDTree(other[:, :3]).query(one[:, :3])[1], 3:])).mean()
        for one, other in pairs
    ]
    return {name: float(value) for name, value in {**found, "normals": np.mean(alike)}.items()}


def simulated(mesh: Mesh | None, modes: int, poisson: float, unknowns: int) -> np.ndarray:
    """Return the logarithms of ω (m,) of the solid in a surface for E = ρ = 1; not numbers where that is impossible."""
    failed = np.full(modes, np.nan)
    if mesh is None or surfaces.volume(*mesh) <= 0:
        return failed
    try:
        values = spline_modes(spline_space(*mesh, unknowns), [poisson], modes)[0]
    except (ValueError, np.linalg.LinAlgError):  # too small or too thin for the splines
        return failed
    with np.errstate(invalid="ignore", divide="ignore"):
        found = 0.5 * np.log(values)
    return found if np.isfinite(found).all() else failed
