"""repair and sheets: unions of known volume, surfaces that touch themselves taken apart, sheets thickened."""

from __future__ import annotations

import numpy as np
import pytest

import shapes
from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.cleaning.judge import Unfit, counted, judge
from vibraverse.geometry.cleaning.sheets import thicken
from vibraverse.geometry.distance.boxes import contains


def flat(n=5):
    vertices, faces = shapes.sheet(n)
    return np.column_stack([vertices[:, :2] / 1.8, np.zeros(len(vertices))]), faces


def hemisphere(radius=0.9):
    vertices, faces = shapes.ball(radius)
    return surfaces.compact(vertices, faces[(vertices[faces][:, :, 2] >= -1e-9).all(axis=1)])


def test_the_union_of_boxes_that_cut_touch_and_nest():
    boxes = [
        shapes.box((2, 1, 1)),
        shapes.box((1, 3, 1), centre=(0.5, 1.0, 0.0)),
        shapes.box((0.2, 0.2, 0.2)),  # inside the first
        shapes.box((2, 1, 1), centre=(-2.0, 0.0, 0.0)),  # against its side
    ]
    points, triangles = repair.unite(*shapes.together(*boxes))
    assert surfaces.volume(points, triangles) == pytest.approx(2 + 3 - 1 + 2)
    judge(points, triangles)


def test_the_union_of_balls_counts_their_lens_once():
    vertices, faces = shapes.together(
        shapes.ball(subdivisions=3), shapes.ball(subdivisions=3, centre=(0.3, 0, 0))
    )
    points, triangles = repair.unite(vertices, faces)
    r, d = 0.9, 0.3
    lens = np.pi * (4 * r + d) * (2 * r - d) ** 2 / 12
    assert surfaces.volume(points, triangles) == pytest.approx(2 * 4 / 3 * np.pi * r**3 - lens, rel=0.02)


def test_an_open_surface_has_no_union():
    with pytest.raises(ValueError, match=r".+"):
        repair.unite(*hemisphere())


@pytest.mark.parametrize(
    ("shift", "what"),
    [((1, 1, 1), "a point"), ((1, 1, 0), "an edge")],
)
def test_boxes_that_touch_in_a_point_or_an_edge_come_apart(shift, what):
    two = shapes.together(shapes.box((1, 1, 1)), shapes.box((1, 1, 1), centre=shift))
    vertices, faces = repair.weld(*repair.unite(*two))
    found = surfaces.topology(faces, len(vertices))
    assert found.pinched_vertices or found.crowded_edges, what
    vertices, faces = repair.separate(vertices, faces, 1e-4)
    found = surfaces.topology(faces, len(vertices))
    assert found.closed_manifold
    assert found.components == 2
    part = surfaces.face_components(faces, len(vertices))
    for i in range(2):
        judge(*surfaces.compact(vertices, faces[part == i]))
    assert surfaces.volume(vertices, faces) == pytest.approx(2.0, rel=1e-3)
    one, other = (vertices[faces[part == i]].reshape(-1, 3) for i in range(2))
    assert np.linalg.norm(one[:, None] - other, axis=2).min() > 5e-5


def test_a_wrap_holds_everything_even_fins_at_crowded_edges():
    vertices, faces = shapes.box((1, 1, 1))
    fin = len(vertices)
    vertices = np.vstack([vertices, [[1.5, 1.5, 0.0]]])
    faces = np.vstack([faces, [*faces[0][:2], fin]])
    points, triangles = repair.wrap(vertices, faces, 0.05, 0.005)
    assert contains(points, triangles, vertices).all()
    assert contains(points, triangles, vertices[faces].mean(axis=1)).all()


def test_triangles_without_area_are_turned_into_their_neighbours():
    vertices, faces = shapes.box()
    a, b, _ = faces[0]
    middle = len(vertices)
    vertices = np.vstack([vertices, 0.5 * (vertices[a] + vertices[b])])
    # The face is split at an edge's middle, its neighbour is not: a triangle without area lies between.
    split = [[a, middle, faces[0][2]], [middle, b, faces[0][2]], [a, b, middle]]
    faces = np.vstack([faces[1:], split])
    assert surfaces.topology(faces, len(vertices)).closed_manifold
    with pytest.raises(Unfit, match="1 triangle without area"):
        judge(vertices, faces)
    points, triangles = repair.flip_caps(vertices, faces)
    judge(points, triangles)
    assert surfaces.volume(points, triangles) == pytest.approx(1.8**3)


def test_a_flat_sheet_becomes_a_plate_of_its_area_times_the_thickness():
    plate = thicken(*flat(), 0.05)
    judge(plate[0], plate[1][:, ::-1] if surfaces.volume(*plate) < 0 else plate[1])
    assert abs(surfaces.volume(*plate)) == pytest.approx(0.05)
    assert np.ptp(plate[0], axis=0) == pytest.approx([1, 1, 0.05])


def test_a_bowl_becomes_a_shell():
    plate = thicken(*hemisphere(), 0.05)
    judge(*plate)
    shell = 2 / 3 * np.pi * ((0.9 + 0.025) ** 3 - (0.9 - 0.025) ** 3)
    # The triangles are inscribed, and the rim leans as its outermost triangles do.
    assert surfaces.volume(*plate) == pytest.approx(shell, rel=0.02)


def test_a_folded_sheet_keeps_its_thickness_along_the_fold():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1]], dtype=float)
    faces = np.array([[0, 1, 2], [2, 1, 3], [0, 4, 1], [1, 4, 5]])
    points, triangles = thicken(vertices, repair.orient(vertices, faces), 0.1)
    # A corner profile of arms 1 and thickness 0.1 whose mitred corner is square: 2 · 0.1 to the midline's arms.
    assert abs(surfaces.volume(points, triangles)) == pytest.approx(0.2, rel=1e-5)
    assert points[:, 1:].min() == pytest.approx(-0.05, abs=1e-6)


def test_counts_are_put_in_words():
    assert counted(1, "open edge") == "1 open edge"
    assert counted(3, "point where the surface touches itself") == "3 points where the surface touches itself"
    assert counted(2, "further body") == "2 further bodies"
    assert counted(2, "cavity") == "2 cavities"
