"""Measures of reconstructed shapes, against numbers that geometry gives."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

pytest.importorskip(
    "skimage", reason="scikit-image is not installed (it belongs to the learning environment)"
)

from vibraverse.contract.seeds import rng
from vibraverse.geometry import surfaces
from vibraverse.geometry.voxels import cell_centres
from vibraverse.learn.baselines.voxels import coarse, smoothed
from vibraverse.learn.reconstructions import (
    Truth,
    compared_distances,
    compared_surfaces,
    extracted,
    measured,
    on_grid,
    simulated,
)
from vibraverse.learn.sampling import distance_samples, sample_surface, signed_distance


def ball(radius: float, centre=(0.0, 0.0, 0.0)):
    """Return the signed distance of a ball."""
    return lambda places: np.linalg.norm(places - np.array(centre), axis=1) - radius


def truth_of(radius: float, count: int = 16_384) -> Truth:
    mesh = trimesh.creation.icosphere(5, radius)
    surface = np.array(mesh.vertices), np.array(mesh.faces)
    around = distance_samples(*surface, count, rng("ball"))
    return Truth(*around, sample_surface(*surface, 4096, rng("points")))


@pytest.fixture(scope="module")
def truth() -> Truth:
    return truth_of(0.6)


def test_two_concentric_balls(truth):
    """Every distance between them is 0.1, and the IoU is the ratio of their volumes."""
    found = measured(ball(0.5), truth, 48, 20, 0.25, 1000)
    inside = 4 / 3 * np.pi * 0.6**3 / 8 * 16_384
    assert found["iou"] == pytest.approx((0.5 / 0.6) ** 3, abs=4 / np.sqrt(inside) / 2)
    assert found["volume_error"] == pytest.approx(1 - (0.5 / 0.6) ** 3, abs=4 / np.sqrt(inside) / 2)
    assert found["band_error"] == pytest.approx(0.1, abs=1e-3)
    assert found["chamfer"] == pytest.approx(0.1, abs=2e-3)
    assert found["f_1%"] == found["f_2%"] == 0  # 2 % of 1.8 is 0.036
    assert found["normals"] == pytest.approx(1, abs=0.01)
    assert found["empty"] == 0
    # A smaller ball sounds higher in proportion; its tones come in groups of equal ones.
    own = measured(ball(0.6), truth, 48, 20, 0.25, 1000)
    ratio = np.exp(found["log_omega"] - own["log_omega"])
    np.testing.assert_allclose(ratio, 0.6 / 0.5, rtol=0.01)


def test_the_true_shape_is_right(truth):
    found = measured(ball(0.6), truth, 64, 20, 0.25, 1000)
    assert found["iou"] > 0.999
    assert found["band_error"] < 1e-3
    # So many of the drawn points have none of the true ones within 1 %.
    lonely = np.exp(-16_384 / (4 * 0.6**2) * (0.01 * 1.8) ** 2)
    assert found["f_1%"] == pytest.approx(2 * (1 - lonely) / (2 - lonely), abs=3e-3)
    assert found["f_2%"] > 0.9999
    assert found["normals"] > 0.99
    # A quarter of the distance of neighbours among the points: half of it in one of two directions.
    floor = 0.25 * np.sqrt(4 * np.pi * 0.6**2 / 16_384)
    assert found["chamfer"] == pytest.approx(floor, rel=0.25)


def test_two_balls_side_by_side(truth):
    """The IoU of equal balls at a distance d follows from their caps."""
    d, r = 0.3, 0.6
    common = np.pi * (4 * r + d) * (2 * r - d) ** 2 / 12
    expected = common / (2 * 4 / 3 * np.pi * r**3 - common)
    found = compared_distances(ball(r, (d, 0, 0)), truth)
    assert found["iou"] == pytest.approx(expected, abs=0.03)
    assert found["volume_error"] < 0.08


def test_points_within_two_percent_are_found(truth):
    mesh = trimesh.creation.icosphere(5, 0.6 + 0.015 * 1.8)
    found = compared_surfaces((np.array(mesh.vertices), np.array(mesh.faces)), truth)
    assert found["f_1%"] == 0
    assert found["f_2%"] > 0.999


def test_an_empty_reconstruction_is_counted(truth):
    found = measured(lambda places: np.ones(len(places)), truth, 16, 20, 0.25, 300)
    assert (found["empty"], found["iou"], found["f_2%"], found["normals"], found["volume_error"]) == (
        1,
        0,
        0,
        0,
        1,
    )
    assert np.isnan(found["chamfer"])
    assert np.isnan(found["log_omega"]).all()


def test_a_surface_that_holds_no_solid_cannot_be_simulated():
    flat = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert np.isnan(simulated((flat, faces), 20, 0.25, 300)).all()
    needle = np.ones((16, 16, 16))
    needle[8, 8, 8] = -1e-9
    assert extracted(needle) is not None
    assert len(simulated(extracted(needle), 20, 0.25, 300)) == 20


def test_the_surface_is_closed_and_of_the_right_volume():
    vertices, faces = extracted(on_grid(ball(0.7), 48))
    assert surfaces.topology(faces, len(vertices)).closed_manifold
    assert surfaces.volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.7, atol=3e-3)
    beyond = extracted(on_grid(ball(1.2), 16))  # it reaches the edge of the grid
    assert surfaces.topology(beyond[1], len(beyond[0])).closed_manifold


def test_the_largest_piece_counts_with_its_cavity():
    def field(places):
        thick = np.maximum(ball(0.6)(places), -ball(0.3)(places))
        return np.minimum(thick, ball(0.15, (0.85, 0, 0))(places))

    vertices, faces = extracted(on_grid(field, 64))
    assert surfaces.topology(faces, len(vertices)).components == 2
    expected = 4 / 3 * np.pi * (0.6**3 - 0.3**3)
    assert surfaces.volume(vertices, faces) == pytest.approx(expected, rel=0.02)
    assert vertices[:, 0].max() < 0.65


def test_coarse_voxels_are_cells_and_smoothed_ones_keep_their_volume():
    centres = cell_centres(16)
    grid = np.stack(np.meshgrid(centres, centres, centres, indexing="ij"), axis=-1)
    voxels = (np.linalg.norm(grid, axis=-1) < 0.6).astype(np.uint8)
    places = rng("places").uniform(-1, 1, (5000, 3))
    inside = voxels[tuple(((places + 1) * 8).astype(int).T)] > 0
    values = coarse(voxels)(places)
    np.testing.assert_array_equal(values < 0, inside)
    # The centre of a cell is half a cell from its sides, or farther.
    assert np.abs(coarse(voxels)(grid.reshape(-1, 3))).min() == pytest.approx(1 / 16)
    mesh = extracted(on_grid(smoothed(voxels), 64))
    assert surfaces.volume(*mesh) == pytest.approx(voxels.sum() * (2 / 16) ** 3, rel=0.02)
    errors = [
        np.abs(field(places) - ball(0.6)(places)).mean() for field in (coarse(voxels), smoothed(voxels))
    ]
    assert errors[1] < errors[0]


def test_truths_of_a_box_agree_with_its_surface():
    box = trimesh.creation.box((1.8, 0.6, 0.4)).subdivide()
    surface = np.array(box.vertices), np.array(box.faces)
    truth = Truth(*distance_samples(*surface, 2000, rng("box")), sample_surface(*surface, 1000, rng("box")))
    found = compared_distances(lambda places: signed_distance(*surface, places), truth)
    assert found["iou"] == 1
    assert max(found["band_error"], found["distance_error"]) < 1e-4
