"""Open and flat parts beside bodies, and bodies that lie apart: what is kept, left out, joined or refused."""

from __future__ import annotations

import numpy as np
import pytest

import shapes
from vibraverse.contract.errors import Refused
from vibraverse.files.meshes import read_mesh
from vibraverse.geometry import surfaces
from vibraverse.geometry.cleaning.cautions import MAX_LEFT_OUT, cautions
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.cleaning.sifting import sift

BOX = shapes.box((1.0, 0.2, 0.3))


def plane(side: float, height: float):
    """Return a square of two triangles, flat at a height."""
    corners = side * np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    return corners + [0, 0, height], np.array([[0, 1, 2], [0, 2, 3]])


def triangle(size: float, centre):
    return size * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]) + centre, np.array([[0, 1, 2]])


def terrain():
    vertices, faces = shapes.sheet()
    return vertices * [3, 3, 1] - [0, 0, 1], faces


def volume(body) -> float:
    """Return a cleaned body's volume in the source's units."""
    return surfaces.volume(body.vertices, body.faces) / body.scale**3


@pytest.mark.parametrize(
    "beside",
    [
        [plane(3.0, -0.4)],
        [plane(3.0, -0.15)],
        [plane(20.0, -0.15)],
        [triangle(0.2, (0, 0, 2))],
        [triangle(0.2, (5, 0, 0)), triangle(0.1, (0, -7, 1)), plane(2.0, -0.3)],
        [terrain()],
    ],
    ids=["plane below", "plane in contact", "huge plane", "triangle", "several", "terrain"],
)
def test_what_encloses_nothing_is_left_out_beside_a_body(beside):
    body = clean(*shapes.together(BOX, *beside))
    assert volume(body) == pytest.approx(0.06, rel=1e-9)
    assert body.longest_side == pytest.approx(1.0)
    assert body.rung == "as-is"
    assert body.left_out_parts == len(beside)
    areas = [surfaces.area(*part) for part in beside]
    assert body.left_out_share == pytest.approx(sum(areas) / (sum(areas) + surfaces.area(*BOX)))
    assert body.repairs[0].startswith(f"left out {len(beside)} open or flat part")
    assert body.deviation.hausdorff == 0
    assert body.volume_change == 0


def test_open_parts_leave_the_rules_for_separate_bodies_as_they_are():
    small = shapes.box((0.5, 0.1, 0.1), centre=(0, 3, 0))
    body = clean(*shapes.together(BOX, small, plane(9.0, -0.4)))
    assert (body.rung, body.dropped_parts, body.left_out_parts) == ("largest", 1, 1)
    assert volume(body) == pytest.approx(0.06)
    with pytest.raises(Refused) as refused:
        clean(*shapes.together(*(shapes.box(centre=(4 * k, 0, 0)) for k in range(3)), plane(20.0, -3)))
    assert refused.value.reason == "separate_bodies"


def test_open_parts_that_enclose_something_together_stay():
    """Six squares a little apart are the sides of a box, whatever lies inside."""
    squares = []
    for axis in range(3):
        for side in (-0.9, 0.9):
            points, faces = plane(1.76, side)
            squares.append((np.roll(points, axis, axis=1), faces))
    knob = shapes.box((0.2, 0.2, 0.2))
    assert sift(*shapes.together(*squares, knob)).together
    body = clean(*shapes.together(*squares, knob))
    assert volume(body) == pytest.approx(1.8**3, rel=0.05)
    assert body.left_out_parts == 0


def test_a_body_with_a_hole_is_kept_beside_a_plane():
    vertices, faces = shapes.box()
    holed = vertices, faces[(vertices[faces][:, :, 2] > -0.89).any(axis=1)]
    body = clean(*shapes.together(holed, plane(40.0, -1.5)))
    assert (body.rung, body.left_out_parts) == ("close", 1)
    assert volume(body) == pytest.approx(1.8**3)


def test_closed_thin_bodies_are_no_open_sheet():
    plates = [shapes.box((1.8, 1.8, 0.004), centre=(0, 0, 0.4 * k)) for k in range(3)]
    body = clean(*shapes.together(*plates[:2]))
    assert (body.rung, body.dropped_parts) == ("largest", 1)
    with pytest.raises(Refused) as refused:
        clean(*shapes.together(*plates))
    assert refused.value.reason == "separate_bodies"


def test_only_what_encloses_nothing_is_an_open_sheet():
    with pytest.raises(Refused) as refused:
        clean(*shapes.together(terrain(), plane(2.0, 1.0)))
    assert refused.value.reason == "not_a_solid"


def row_of_boxes(gap: float = 1.0):
    """Return six boxes in a row with gaps of 1 mm, and their volume in mm³."""
    boxes = [shapes.box((20, 20, 20), centre=((20 + gap) * k, 0, 0)) for k in range(6)]
    return shapes.together(*boxes), 6 * 20**3


def test_a_wrap_that_joins_bodies_says_how_many_and_what_that_adds():
    mesh, before = row_of_boxes()
    body = clean(*mesh)
    assert (body.rung, body.joined_bodies) == ("wrap", 6)
    assert body.joined_growth == pytest.approx(volume(body) / before - 1, abs=1e-6)
    # The wrap fills most of five gaps of 20 x 20 x 1 mm³, 4 % of the volume, and rounds what lies around them.
    assert 0.02 < body.joined_growth < 0.08
    assert body.repairs[-1].startswith("joined 6 bodies that lie apart, which changed their volume by +")


def test_a_wrap_that_changes_the_volume_too_much_is_not_taken():
    mesh, _ = row_of_boxes()
    with pytest.raises(Refused) as refused:
        clean(*mesh, max_joined=0.02)
    assert refused.value.reason == "separate_bodies"
    assert "wrap: joining 6 bodies that lie apart would change their volume by +" in refused.value.message
    assert "at most 2 % are allowed" in refused.value.message
    assert clean(*mesh, max_joined=0.02, max_dropped=0.9).rung == "largest"


def test_what_was_left_out_or_joined_is_warned_of():
    record = {
        "deviation": {"invented": 0.0},
        "dropped": {"parts": 0, "volume_share": 0.0},
        "repairs": [],
        "warnings": ["the file holds 2 scenes, and scene 0 is read."],
        "left_out": {"parts": 1, "area_share": MAX_LEFT_OUT},
        "joined": {"bodies": 0, "volume_growth": 0.0},
    }
    assert cautions(record) == record["warnings"]
    record["left_out"]["area_share"], record["joined"] = 0.9, {"bodies": 6, "volume_growth": 0.059}
    _, left_out, joined = cautions(record)
    assert left_out.startswith("90 % of the area is left out (at most 5 %)")
    assert "6 bodies that lie apart were joined and ring as one" in joined
    assert "+5.9 %" in joined
    for key in ("warnings", "left_out", "joined"):  # records of earlier versions have none
        del record[key]
    assert cautions(record) == []


def test_cases_of_bug_reports(shared_cases):
    for path in (shared_cases / "stray-flat-part").glob("*.stl"):
        mesh = read_mesh(path)
        body = clean(mesh.vertices, mesh.faces)
        assert volume(body) == pytest.approx(6e-5)  # 60 cm³
        assert body.longest_side == pytest.approx(0.1)
        assert body.left_out_parts == 1
    mesh = read_mesh(next((shared_cases / "bodies-fused-by-wrap").glob("*.stl")))
    assert clean(mesh.vertices, mesh.faces).joined_bodies == 6
