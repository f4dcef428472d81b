"""Shapes sought by descent through the physics: derivatives through torch, searches that come near, the stage."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_features import OPTIONS, sides_of, write, write_splits  # noqa: E402

from vibraverse.config.learn import Learn  # noqa: E402
from vibraverse.contract.seeds import rng  # noqa: E402
from vibraverse.learn.baselines.rows import baselines  # noqa: E402
from vibraverse.learn.descents import all_sought, chosen, sides, true_distance  # noqa: E402
from vibraverse.learn.diffsound import Eigenvalues, EmptyLevelSetError, Grid, Settings, search  # noqa: E402
from vibraverse.learn.tasks import task_at  # noqa: E402

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


@pytest.fixture(scope="module")
def task(tmp_path_factory):
    """Task ``reconstruction`` on the features of a few boxes."""
    folder = tmp_path_factory.mktemp("descents")
    objects = [f"{family}-{number:04d}" for family in ("bar", "cup") for number in range(6)]
    shard = write(folder / "0", objects, invented_ritz=True)
    splits = write_splits(folder / "splits.tsv", objects)
    learn = Learn(preset="tiny", features=OPTIONS, frequencies={"network": {"points": 512}})
    return task_at([shard / "features.json"], splits, learn.run("reconstruction", "object", "truncated", 0))


def test_sides_are_known_of_cells_outside_and_of_those_beside_them():
    voxels = np.zeros((8, 8, 8), dtype=np.uint8)
    voxels[1:7, 1:7, 1:7] = 1
    places, known = sides(voxels)
    assert (known == 1).sum() == 8**3 - 6**3
    assert (known == -1).sum() == 6**3 - 4**3
    np.testing.assert_allclose(np.abs(places[known == -1]).max(axis=1), 0.625)


def test_the_distance_of_a_body_is_near_that_of_its_box(task):
    half = sides_of(task.samples.object[0]) / 2
    points = rng("places").uniform(-1, 1, (500, 3))
    apart = np.abs(points) - half
    true = np.linalg.norm(np.maximum(apart, 0), axis=1) + np.minimum(apart.max(axis=1), 0)
    found = true_distance(task.samples, 0)(points)
    np.testing.assert_allclose(found, true, atol=0.09)  # the points lie that far apart
    far = np.abs(true) > 0.02
    np.testing.assert_array_equal(np.sign(found[far]), np.sign(true[far]))


def test_bodies_are_sought_and_those_that_are_done_stay(task, tmp_path):
    settings = Settings(cells=8, iterations=12)
    bodies = chosen(task, 2)
    assert sorted(chosen(task, 2, 0, 2).tolist() + chosen(task, 2, 1, 2).tolist()) == sorted(bodies.tolist())
    found = all_sought(task, bodies, settings, tmp_path)
    assert found["iou"].shape == (2, 2)
    assert (found["loss_least"] < 0.7 * found["loss_first"]).all()
    assert (found["iou"] > 0.3).all()
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npz")}
    assert len(kept) == 2
    next(iter(kept)).unlink()
    again = all_sought(task, bodies, settings, tmp_path)
    assert sum(path.stat().st_mtime_ns == time for path, time in kept.items()) == 1
    for name, values in found.items():
        if name not in ("seconds", "search_seconds"):
            np.testing.assert_array_equal(again[name], values, err_msg=name)
    rows = {name: judgement.rows for name, _, judgement in baselines(task, [found])}
    for name in (
        "DiffSound, own target",
        "DiffSound, true target",
        "smoothed voxels, the bodies of DiffSound",
    ):
        (row,) = [row for row in rows[name] if (row["source"], row["measure"]) == ("all", "iou")]
        assert row["count"] == 2
    assert rows["DiffSound, own target"][0]["value"] == pytest.approx(found["iou"][:, 0].mean())
