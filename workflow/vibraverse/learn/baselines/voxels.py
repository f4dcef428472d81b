"""Shapes without learning: the coarse voxels as they are, and smoothed."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, zoom

from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.voxels import coarse_mesh
from vibraverse.learn.reconstructions import Field, extracted
from vibraverse.learn.sampling import signed_distance

#: Standard deviation of the smoothing, in cells, and how many samples a cell has afterwards along an axis.
_SMOOTHING, _FINER = 1.0, 4


def coarse(voxels: np.ndarray) -> Field:
    """Return the signed distance of the occupied cells (n, n, n) of [-1, 1]³."""
    closest, n = ClosestPoint(*coarse_mesh(voxels)), len(voxels)

    def field(places: np.ndarray) -> np.ndarray:
        cells = np.clip(((places + 1.0) * (n / 2)).astype(int), 0, n - 1)
        distance = closest.distance(places)
        return np.where(voxels[tuple(cells.T)] > 0, -distance, distance)

    return field


def smoothed(voxels: np.ndarray) -> Field:
    """Return the signed distance of the cells after a Gaussian of one cell, at the level that keeps their volume."""
    blurred = gaussian_filter(voxels.astype(float), _SMOOTHING, mode="constant")
    # With samples at the new cells' centres the level set stays where it is.
    finer = zoom(blurred, _FINER, order=1, mode="nearest", grid_mode=True)
    mesh = extracted(np.quantile(finer, 1.0 - (voxels > 0).mean()) - finer)
    return lambda places: signed_distance(*mesh, places)


#: The baselines by name: occupied cells to a field.
VOXELS = {"coarse voxels": coarse, "smoothed voxels": smoothed}
