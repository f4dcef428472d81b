"""deviation: two-sided distances between bodies whose distances are known, and which points are inside."""

from __future__ import annotations

import numpy as np
import pytest

import shapes
from vibraverse.geometry import surfaces
from vibraverse.geometry.distance.boxes import contains
from vibraverse.geometry.distance.deviation import deviation, samples


def test_concentric_balls_are_their_radii_apart():
    small, large = shapes.ball(0.8, 5), shapes.ball(0.9, 5)
    grown, shrunk = deviation(small, large, []), deviation(large, small, [])
    diagonal = np.linalg.norm(np.ptp(large[0], axis=0)), np.linalg.norm(np.ptp(small[0], axis=0))
    # The small one is inside the large one: nothing is lost, all of it was swallowed, all of the surface is new.
    assert grown.source_to_body == 0.0
    assert (grown.swallowed, grown.invented) == (pytest.approx(1.0), pytest.approx(1.0))
    assert grown.body_to_source * diagonal[0] == pytest.approx(0.1, rel=2e-3)
    assert grown.mean_body_to_source * diagonal[0] == pytest.approx(0.1, rel=1e-2)
    assert shrunk.source_to_body * diagonal[1] == pytest.approx(0.1, rel=2e-3)
    assert shrunk.hausdorff == max(shrunk.source_to_body, shrunk.body_to_source)
    assert shrunk.swallowed == 0.0


def test_a_box_and_the_ball_inside_it():
    found = deviation(shapes.box(), shapes.ball(subdivisions=5), [])
    # From the corner: 0.9 (√3 - 1); from the ball's surface at the diagonals: the distance to the nearest face.
    diagonal = 1.8 * 3**0.5
    assert found.source_to_body * diagonal == pytest.approx(0.9 * (3**0.5 - 1), abs=1e-3)
    assert found.body_to_source * diagonal == pytest.approx(0.9 * (1 - 3**-0.5), abs=3e-3)


def test_the_sampling_error_bounds_what_samples_miss():
    # A cut in the middle of one large triangle, between any two samples of a coarse set.
    vertices, faces = shapes.box()
    points, weights, spacing = samples(vertices, faces, 0.3)
    assert weights.sum() == pytest.approx(surfaces.area(vertices, faces))
    generator = np.random.default_rng(3)
    corners = vertices[faces[generator.integers(0, len(faces), 4000)]]
    share = generator.dirichlet([1, 1, 1], len(corners))
    anywhere = np.einsum("nc,ncd->nd", share, corners)
    nearest = np.linalg.norm(anywhere[:, None] - points, axis=2).min(axis=1)
    assert 0.3 * spacing < nearest.max() <= 2 / 3 * spacing
    assert spacing == 0.3


def test_what_was_dropped_is_not_missed():
    kept, dropped = shapes.box((1, 1, 1)), shapes.box((0.5, 0.5, 0.5), centre=(3, 0, 0))
    source = shapes.together(kept, dropped)
    assert deviation(source, kept, [dropped]).hausdorff < 1e-12
    assert deviation(source, kept, []).source_to_body * 3**0.5 == pytest.approx(np.hypot(2.75, 0.0), rel=1e-9)


@pytest.mark.parametrize("turned", [False, True])
def test_points_inside_a_ring_are_told_from_those_in_its_hole(turned):
    from trimesh.creation import torus

    mesh = torus(0.6, 0.25, major_sections=96, minor_sections=64)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    points = np.random.default_rng(0).uniform(-0.9, 0.9, (5000, 3))
    away = np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.6, points[:, 2])
    clear = np.abs(away - 0.25) > 2e-3
    inside = contains(vertices, faces[:, ::-1] if turned else faces, points)
    assert np.array_equal(inside[clear], away[clear] < 0.25)
    # Straight above and below vertices and edges too.
    assert contains(
        *shapes.box(), np.array([[0, 0, 0], [0.9 - 1e-9, 0.9 - 1e-9, 0], [0.9 + 1e-9, 0, 0]])
    ).tolist() == [
        True,
        True,
        False,
    ]
