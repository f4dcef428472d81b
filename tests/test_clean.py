"""clean: every rung of the ladder on a mesh that needs it, the refusals, and the stage's products."""

from __future__ import annotations

import json

import numpy as np
import pytest

import shapes
from mesh_bytes import ply
from vibraverse.contract.errors import ChildFailed, Refused
from vibraverse.contract.refusal import read_refusal
from vibraverse.files import meshes
from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.cleaning.judge import judge
from vibraverse.geometry.cleaning.ladder import RUNGS
from vibraverse.geometry.distance.closest import ClosestPoint


def bundled(name):
    from importlib.util import find_spec
    from pathlib import Path

    return Path(find_spec("pyvista").submodule_search_locations[0]) / "examples" / name


def check_normalised(body):
    judge(body.vertices, body.faces)
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    assert np.allclose(low + high, 0, atol=1e-12)
    assert (high - low).max() == pytest.approx(1.8, abs=1e-12)


def test_a_good_mesh_is_only_moved_and_scaled():
    vertices, faces = shapes.ball(radius=40.0, centre=(100.0, -7.0, 3.0))
    body = clean(vertices, faces)
    check_normalised(body)
    assert (body.rung, body.repairs) == ("as-is", [])
    assert np.array_equal(body.faces, faces)
    assert np.allclose((vertices - body.centre) * body.scale, body.vertices, atol=1e-12)
    assert body.longest_side == pytest.approx(80.0)


def test_triangles_that_point_the_wrong_way_are_turned():
    vertices, faces = shapes.ball(subdivisions=2)
    wrong = faces.copy()
    wrong[::3] = wrong[::3, ::-1]
    body = clean(vertices, wrong)
    assert body.repairs == [f"turned {len(faces[::3])} triangles"]
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(surfaces.volume(vertices, faces))


def test_a_mesh_turned_inside_out_is_turned_back():
    vertices, faces = shapes.box()
    body = clean(vertices, faces[:, ::-1])
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(1.8**3)


def test_points_that_are_almost_equal_are_joined():
    vertices, faces = shapes.ball(subdivisions=3)
    noise = np.random.default_rng(1).uniform(-1e-6, 1e-6, (3 * len(faces), 3))
    soup = vertices[faces].reshape(-1, 3) + noise
    body = clean(soup, np.arange(len(soup)).reshape(-1, 3))
    check_normalised(body)
    assert body.rung == "weld"
    assert len(body.faces) == len(faces)


def test_a_missing_side_is_closed():
    vertices, faces = shapes.box()
    body = clean(vertices, faces[(vertices[faces][:, :, 2] > -0.89).any(axis=1)])
    check_normalised(body)
    assert body.rung == "close"
    assert [step["rung"] for step in body.ladder] == ["as-is", "weld"]
    assert body.ladder[0]["failed"] == "4 open edges"
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(1.8**3)
    # The cover's middle is farthest from what was there: half a side of 1.8, by a diagonal of 1.8 √3.
    assert body.deviation.body_to_source == pytest.approx(0.5 / 3**0.5, abs=body.deviation.sampling_error)
    assert body.deviation.source_to_body == pytest.approx(0, abs=1e-12)
    assert body.volume_change is None
    assert body.area_change == pytest.approx(6 / 5 - 1)


def test_overlapping_parts_become_their_union():
    body = clean(*shapes.together(shapes.box((2, 1, 1)), shapes.box((1, 3, 1), centre=(0.5, 1.0, 0.0))))
    check_normalised(body)
    assert body.rung == "unite"
    assert body.repairs == ["united 2 parts, which left 1"]
    # 2 + 3 - 1 cubic units, in a bounding box whose longest side is 3.
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(4 * 0.6**3, rel=1e-6)


def test_triangles_that_cut_each_other_are_replaced():
    vertices, faces = shapes.ball(subdivisions=4)
    dented = vertices.copy()
    dented[0] *= -1.01  # one vertex pulled through the opposite side
    body = clean(dented, faces)
    check_normalised(body)
    assert body.rung == "unite"
    assert body.repairs == ["resolved 10 triangles that cut or touch each other"]
    # The tip that reached through, inside out, is gone; the dent stays.
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(
        surfaces.volume(dented, faces), rel=0.01
    )
    assert body.deviation.hausdorff < 0.01


def test_parts_that_touch_nothing_are_dropped_and_named():
    body = clean(*shapes.together(shapes.box(), shapes.box((0.5, 0.5, 0.5), centre=(5, 0, 0))))
    check_normalised(body)
    assert body.rung == "largest"
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(1.8**3)
    assert body.repairs[-1].startswith("dropped 1 body with 2")
    assert body.dropped_parts == 1
    # 0.5³ of 0.5³ + 1.8³
    assert body.dropped_share == pytest.approx(0.125 / (0.125 + 5.832))
    assert body.deviation.hausdorff < 1e-9  # what was dropped is not missed


def test_bodies_apart_that_hold_more_than_may_be_dropped_are_refused():
    boxes = [shapes.box(), shapes.box(centre=(4, 0, 0)), shapes.box(centre=(0, 4, 0))]
    with pytest.raises(Refused) as refused:
        clean(*shapes.together(*boxes))
    assert refused.value.reason == "separate_bodies"
    assert "largest: 2 further bodies with 66.7 % of the volume" in refused.value.message
    assert "at most 50 % may be dropped" in refused.value.message
    assert "clean.max_dropped" in refused.value.advice
    assert clean(*shapes.together(*boxes), max_dropped=0.7).dropped_parts == 2
    assert clean(*shapes.together(*boxes[:2])).dropped_share == pytest.approx(0.5)


def test_a_cavity_in_the_source_is_filled_and_said():
    body = clean(*shapes.hollow_ball())
    assert (body.rung, body.filled_cavities) == ("unite", 1)
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(
        surfaces.volume(*shapes.ball(subdivisions=3))
    )
    # A body inside a body is none.
    nested = clean(*shapes.together(shapes.ball(subdivisions=3), shapes.ball(0.5, 3)))
    assert (nested.rung, nested.filled_cavities) == ("unite", 0)


def test_an_open_sheet_is_thickened_when_asked():
    vertices, faces = shapes.sheet()
    flat = vertices * [1, 1, 0]
    body = clean(flat, faces, open_sheets="thicken", sheet_thickness=0.05)
    check_normalised(body)
    assert body.rung == "thicken"
    assert body.repairs == ["thickened 1 sheet to 5 % of the longest side"]
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(1.8**3 * 0.05)
    body = clean(vertices, faces, open_sheets="thicken")
    check_normalised(body)
    assert body.ladder[-1] == {"rung": "wrap", "failed": "a wrap around it has nothing inside"}
    share = surfaces.area((vertices - body.centre) * body.scale, faces) * 1.8 * 0.02
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(share, rel=0.02)
    # Half the thickness, by the diagonal.
    assert body.deviation.hausdorff == pytest.approx(0.01 * 1.8 / np.linalg.norm([1.8, 1.8, 0.4]), rel=0.05)


def test_a_closed_surface_says_how_its_volume_and_area_changed():
    vertices, faces = shapes.ball(subdivisions=3)
    inside = shapes.box((0.4, 0.4, 0.4), centre=(0.9, 0, 0))
    body = clean(*shapes.together((vertices, faces), inside))
    ball, box = surfaces.volume(vertices, faces), 0.064
    united = surfaces.volume(body.vertices, body.faces) / body.scale**3
    assert body.volume_change == pytest.approx(united / (ball + box) - 1)
    # A little less than half of the box is inside, since the ball bends away.
    assert body.volume_change == pytest.approx(-0.46 * box / (ball + box), rel=0.02)


@pytest.mark.parametrize(("name", "volume"), [("airplane.ply", 0.0444), ("ant.ply", 0.0832)])
def test_bundled_models_of_loose_parts_become_bodies_that_look_like_them(name, volume):
    source = meshes.read_mesh(bundled(name))
    body = clean(source.vertices, source.faces)
    check_normalised(body)
    assert body.rung == "wrap"
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(volume, rel=0.02)
    there = (source.vertices - body.centre) * body.scale
    away = np.linalg.norm(ClosestPoint(body.vertices, body.faces)(there) - there, axis=1)
    seen = np.linalg.norm(ClosestPoint(there, source.faces)(body.vertices) - body.vertices, axis=1)
    # Nothing the source shows is lost, and all of the body is near the source but for the bridges over gaps.
    assert np.percentile(away, 95) < 0.02
    assert np.percentile(seen, 90) < 0.02


def test_the_nut_needs_no_repair():
    source = meshes.read_mesh(bundled("nut.ply"))
    body = clean(source.vertices, source.faces)
    assert body.rung == "as-is"
    assert surfaces.topology(body.faces, len(body.vertices)).genus == 1


def test_public_closed_models_pass(shared_meshes):
    rungs = {}
    for path in sorted((shared_meshes / "clean").iterdir()):
        source = meshes.read_mesh(path)
        body = clean(source.vertices, source.faces)
        check_normalised(body)
        rungs[path.name] = body.rung
    assert len(rungs) == 14
    assert {name: rung for name, rung in rungs.items() if rung != "as-is"} == {
        "featuretype.stl": "weld",
        "wingnut.obj": "unite",
    }


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        ((np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]])), "not_a_solid"),
        (shapes.sheet(), "not_a_solid"),
        ((np.zeros((3, 3)), np.array([[0, 1, 2]])), "empty"),
    ],
)
def test_what_bounds_no_volume_is_refused(mesh, reason):
    with pytest.raises(Refused) as refused:
        clean(*mesh)
    assert refused.value.reason == reason
    assert refused.value.advice
    if reason == "not_a_solid":
        assert refused.value.message.startswith("The mesh is an open sheet: ")
        assert "clean.open_sheets" in refused.value.advice


def test_a_mesh_beyond_the_limit_is_refused():
    with pytest.raises(Refused) as refused:
        clean(*shapes.ball(subdivisions=3), max_triangles=1000)
    assert refused.value.reason == "too_large"
    assert "1280" in refused.value.message


def test_the_ladder_climbs_from_gentle_to_severe():
    assert [name for name, _ in RUNGS] == [
        "as-is",
        "weld",
        "close",
        "unite",
        "wrap",
        "largest",
        "largest-wrap",
    ]


def test_bodies_apart_are_united_once_for_all_rungs(monkeypatch):
    from vibraverse.geometry import repair

    calls = []
    real = repair.join
    monkeypatch.setattr(repair, "join", lambda bodies: calls.append(len(bodies)) or real(bodies))
    pair = [shapes.ball(0.4, 2, (x, 0, 0)) for x in (0.0, 0.3)]
    body = clean(*surfaces.joined([*pair, shapes.ball(0.3, 2, (3, 0, 0))]))
    assert body.rung == "largest"
    assert [step["rung"] for step in body.ladder] == ["as-is", "weld", "close", "unite", "wrap"]
    assert body.repairs[0] == "united 3 parts, which left 2"
    assert body.dropped_parts == 1
    assert calls == [3]


def test_a_very_dense_mesh_is_thinned_without_losing_volume(monkeypatch):
    import vibraverse.geometry.cleaning.clean as module

    monkeypatch.setattr(module, "_DENSE_FACES", 3000)
    vertices, faces = shapes.ball(subdivisions=4)
    assert len(clean(vertices, faces).faces) == len(faces)  # nothing on a ball can go without moving it
    vertices, faces = shapes.box()
    for _ in range(5):
        vertices, faces = shapes.split(vertices, faces)
    body = clean(vertices, faces)
    check_normalised(body)
    assert len(faces) == 12_288
    assert len(body.faces) == 12
    assert body.repairs == ["thinned 12288 triangles to 12"]
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(1.8**3, rel=1e-4)


def test_topology_counts_what_is_wrong():
    vertices, faces = shapes.box()
    assert surfaces.topology(faces, 8).closed_manifold
    assert surfaces.topology(faces[1:], 8).open_edges == 3
    assert surfaces.topology(np.vstack([faces, faces[:1, ::-1]]), 8).crowded_edges == 3
    two = shapes.together((vertices, faces), (vertices + 1.8, faces))
    touching = surfaces.topology(repair.weld(*two)[1], 16)
    assert (touching.pinched_vertices, touching.open_edges) == (1, 0)


@pytest.fixture
def run(vibraverse, tmp_path):
    """Run the stage on the bytes of a mesh; return its exit status, its messages and the two products."""

    def call(content: bytes, name: str = "run", **source):
        (tmp_path / "source.mesh").write_bytes(content)
        (tmp_path / "source.json").write_text(json.dumps({"format": "ply", "file": "mine.ply", **source}))
        surface, record = tmp_path / f"{name}.ply", tmp_path / f"{name}.json"
        status, _, errors = vibraverse(
            *("clean", "--object", "mine", "--mesh", tmp_path / "source.mesh"),
            *("--source-record", tmp_path / "source.json", "--surface", surface, "--record", record),
        )
        return status, errors, surface, record

    return call


def test_the_stage_writes_the_surface_and_what_was_done(run):
    vertices, faces = shapes.ball(radius=20.0, subdivisions=2)
    status, errors, surface, record = run(meshes.ply_bytes(vertices, faces), unit_m=0.01, size_m=None)
    assert status == 0, errors
    said = json.loads(record.read_text())
    points, triangles = meshes.read_ply(surface)
    assert (said["rung"], said["vertices"], said["triangles"]) == ("as-is", len(points), len(triangles))
    assert said["size_m"] == pytest.approx(0.4)
    assert said["scale"] == pytest.approx(1.8 / 40)
    assert said["volume"] == pytest.approx(surfaces.volume(points, triangles))
    assert said["genus"] == 0
    assert said["ladder"] == []
    assert said["dropped"] == {"parts": 0, "volume_share": 0.0}
    assert (said["filled_cavities"], said["volume_change"], said["area_change"]) == (0, 0.0, 0.0)
    assert said["deviation"]["hausdorff"] == 0.0
    again = run(meshes.ply_bytes(vertices, faces), "again", unit_m=0.01, size_m=None)
    assert surface.read_bytes() == again[2].read_bytes()
    assert record.read_bytes() == again[3].read_bytes()


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("empty.obj", "empty"),
        ("empty.stl", "empty"),
        ("flat_plane.ply", "not_a_solid"),
        ("notenoughindices.obj", None),
        ("points_only.ply", "empty"),
    ],
)
def test_invalid_files_are_refused_with_the_true_reason(run, shared_meshes, name, reason):
    path = shared_meshes / "invalid" / name
    status, errors, surface, record = run(path.read_bytes(), format=path.suffix[1:], file=name)
    assert status == 0
    assert "Traceback" not in errors
    refusal = read_refusal(surface)
    assert refusal == read_refusal(record)
    assert refusal.stage == "clean"
    assert refusal.message
    assert refusal.advice
    if reason:
        assert refusal.reason == reason


def broken_reader(*_):
    raise TypeError("a mistake of ours")


def test_a_mistake_in_the_child_ends_the_job(tmp_path, vibraverse, monkeypatch):
    """It is not a refusal: nothing is written, and the child's traceback shows the place."""
    (tmp_path / "a.mesh").write_bytes(meshes.ply_bytes(*shapes.box()))
    (tmp_path / "a.json").write_text(json.dumps({"format": "ply", "file": "a.ply"}))
    monkeypatch.setattr("vibraverse.geometry.cleaning.clean.clean", broken_reader)
    with pytest.raises(ChildFailed, match="a mistake of ours"):
        vibraverse(
            "clean", "--object", "a", "--mesh", tmp_path / "a.mesh", "--source-record", tmp_path / "a.json",
            "--surface", tmp_path / "b.ply", "--record", tmp_path / "b.json",
        )  # fmt: skip
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.mesh"]


@pytest.mark.parametrize("edges", [1, 5_500_000])
def test_the_limits_hold_while_the_file_is_read(tmp_path, vibraverse, edges):
    """A cube in a long text: reading the text takes memory that the repair does not."""
    head, _, rows = ply().partition(b"end_header\n")
    head += b"element edge %d\nproperty float length\nend_header\n" % edges
    (tmp_path / "a.mesh").write_bytes(head + rows + b"10\n" * edges)
    (tmp_path / "a.json").write_text(json.dumps({"format": "ply", "file": "a.ply"}))
    status, _, said = vibraverse(
        "clean", "--object", "a", "--mesh", tmp_path / "a.mesh", "--source-record", tmp_path / "a.json",
        "--surface", tmp_path / "b.ply", "--record", tmp_path / "b.json",
        "--options", json.dumps({"limits": {"memory_mb": 350}}),
    )  # fmt: skip
    assert status == 0, said
    refusal = read_refusal(tmp_path / "b.json")
    if edges == 1:
        assert refusal is None
        assert json.loads((tmp_path / "b.json").read_text())["source_triangles"] == 12
    else:
        assert refusal.reason == "limit"
        assert refusal.message == "Reading and repairing the mesh needed more than 350 MB."
