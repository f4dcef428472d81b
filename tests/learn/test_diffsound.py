"""Shapes found by descent through the physics: derivatives through torch, and a search that comes near."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from vibraverse.contract.seeds import rng  # noqa: E402
from vibraverse.learn.diffsound import Eigenvalues, EmptyLevelSetError, Grid, Settings, search  # noqa: E402

pytestmark = pytest.mark.learn
MODES = 12


def ellipsoid(points: np.ndarray, axes=(0.75, 0.6, 0.5)) -> np.ndarray:
    """Return about the distance to an ellipsoid."""
    scaled = np.linalg.norm(points / np.array(axes), axis=1)
    return (scaled - 1.0) * min(axes)


def values_of(distance: np.ndarray, grid: Grid) -> np.ndarray:
    return Eigenvalues.apply(torch.from_numpy(distance), grid, 0.3, MODES, 1.0).numpy()


def test_the_gradient_is_the_difference():
    grid = Grid(6)
    distance = ellipsoid(grid.points) + 0.02 * grid.points[:, 0] * grid.points[:, 1]
    weights = torch.from_numpy(rng("weights").standard_normal(MODES))
    leaf = torch.from_numpy(distance).requires_grad_()
    (Eigenvalues.apply(leaf, grid, 0.3, MODES, 1.0) @ weights).backward()
    move, step = rng("move").standard_normal(len(distance)), 1e-5
    ahead, back = (values_of(distance + sign * step * move, grid) @ weights.numpy() for sign in (1, -1))
    assert leaf.grad.numpy() @ move == pytest.approx((ahead - back) / (2 * step), rel=1e-4)


def test_a_search_finds_the_spectrum_and_the_shape_of_another_ellipsoid():
    """From a ball, with the sides of the points known that are not close to the surface."""
    grid = Grid(10)
    wanted = values_of(ellipsoid(grid.points), grid)
    points = rng("known").uniform(-1, 1, (400, 3))
    far = np.abs(ellipsoid(points)) > 0.06
    known = points[far], np.sign(ellipsoid(points[far]))
    settings = Settings(cells=10, iterations=60)
    found = search(wanted, 0.3, lambda at: np.linalg.norm(at, axis=1) - 0.62, known, settings, seed=0)
    assert min(found.spectrum) < 0.1 * found.spectrum[0]
    begun, ended = (
        iou(distance, ellipsoid(grid.points))
        for distance in (np.linalg.norm(grid.points, axis=1) - 0.62, found.distance)
    )
    assert ended > begun + 0.05


def iou(one: np.ndarray, other: np.ndarray) -> float:
    """Return intersection over union of what is negative."""
    return np.sum((one < 0) & (other < 0)) / np.sum((one < 0) | (other < 0))


def test_an_empty_first_guess_is_an_error():
    points = np.zeros((1, 3))
    with pytest.raises(EmptyLevelSetError):
        search(
            np.ones(MODES),
            0.3,
            lambda places: np.ones(len(places)),
            (points, np.ones(1)),
            Settings(cells=4),
            0,
        )
