"""Points of bodies: on voxels, far from each other, around surfaces."""

from __future__ import annotations

import numpy as np
import trimesh
from make_features import OPTIONS, box_of, sides_of, voxels_of

from vibraverse.contract.seeds import rng
from vibraverse.geometry.voxels import cell_centres
from vibraverse.learn.features import voxel_arrays
from vibraverse.learn.sampling import (
    EVEN,
    NEAR,
    ON,
    UNIT,
    distance_samples,
    farthest,
    signed_distance,
    voxel_cloud,
)

BOX = "bar-0000"


def box_distance(places: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return the signed distance of places (n, 3) from a box, by formula."""
    apart = np.abs(places) - sides / 2
    return np.linalg.norm(np.maximum(apart, 0), axis=1) + np.minimum(apart.max(axis=1), 0)


def test_signed_distances_are_those_of_the_formula():
    vertices, faces = box_of(BOX, "solid")
    places = rng("places").uniform(-1, 1, (3000, 3))
    expected = box_distance(places, sides_of(BOX))
    np.testing.assert_allclose(signed_distance(vertices, faces, places), expected, atol=1e-12)


def test_a_cavity_is_outside():
    """A ball in a ball: the distance is the larger of those from the two."""
    outer, inner = trimesh.creation.icosphere(5, 0.9), trimesh.creation.icosphere(5, 0.4)
    vertices = np.vstack([outer.vertices, inner.vertices])
    faces = np.vstack([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)])
    places = rng("places").uniform(-1, 1, (3000, 3))
    away = np.linalg.norm(places, axis=1)
    expected = np.maximum(away - 0.9, 0.4 - away)
    np.testing.assert_allclose(signed_distance(vertices, faces, places), expected, atol=1e-3)


def test_samples_are_even_near_and_on_the_surface():
    sides = sides_of(BOX)
    places, distances = distance_samples(*box_of(BOX, "solid"), 4000, rng("samples"))
    assert (places.dtype, distances.dtype) == (np.int16, np.float16)
    even, near, on = UNIT * places[[EVEN, NEAR, ON]]
    assert set(np.unique(even)) <= set(cell_centres(128))  # nothing is rounded
    share = (distances[EVEN] < 0).mean()
    volume = sides.prod() / 8
    assert abs(share - volume) < 4 * np.sqrt(volume * (1 - volume) / 4000)
    assert 0.3 < (distances[NEAR] < 0).mean() < 0.6
    assert np.abs(box_distance(on, sides)).max() < UNIT
    for kind, where in ((EVEN, even), (NEAR, near)):
        np.testing.assert_allclose(distances[kind], box_distance(where, sides), rtol=5e-4, atol=1e-6)
    again = distance_samples(*box_of(BOX, "solid"), 4000, rng("samples"))
    np.testing.assert_array_equal(again[0], places)


def test_farthest_points_are_far_and_nested():
    points = rng("far").uniform(-1, 1, (2000, 3))
    chosen = farthest(points, 100)
    assert len(set(chosen)) == 100
    np.testing.assert_array_equal(farthest(points, 30), chosen[:30])
    found = points[chosen]
    apart = np.linalg.norm(found[:, None] - found, axis=2) + 9 * np.eye(100)
    to_chosen = np.linalg.norm(points[:, None] - found, axis=2).min(axis=1)
    # Every point is nearer to a chosen one than any two of these are to each other.
    assert to_chosen.max() <= apart.min() * (1 + 1e-6)


def test_voxel_points_lie_on_the_sides_of_occupied_cells():
    voxels = voxels_of(BOX)
    cloud = voxel_cloud(voxels, 3000, BOX)
    inside, outside = (cloud[:, :3] + step * cloud[:, 3:] for step in (-0.01, 0.01))
    at = [voxels[tuple(((places + 1) * 8).astype(int).T)] for places in (inside, outside)]
    assert at[0].all()
    assert not at[1].any()
    assert (np.sort(np.abs(cloud[:, 3:]), axis=1) == [0, 0, 1]).all()
    np.testing.assert_array_equal(voxel_cloud(voxels, 3000, BOX), cloud)
    made = voxel_arrays(voxels, BOX, OPTIONS)
    assert made["farthest"].shape == (OPTIONS.farthest,)
    assert made["farthest"].max() < OPTIONS.voxel_points
