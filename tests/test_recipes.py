"""The tetrahedra's ladder of recipes: its limits, thinning, wraps, and what the record and the log say."""

from __future__ import annotations

import json
import os
import signal
import time

import numpy as np
import pytest

import shapes
from vibraverse.config.geometry import Tets
from vibraverse.contract import products
from vibraverse.contract.errors import Refused
from vibraverse.contract.limits import run_limited
from vibraverse.contract.progress import report, reports_to
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.stage import Job, run
from vibraverse.files import meshes
from vibraverse.flow.steps import BY_NAME
from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.meshing import envelope
from vibraverse.geometry.meshing import remesh as remesh_module
from vibraverse.geometry.meshing import sizes as sizes_module
from vibraverse.geometry.meshing import tets as tets_module
from vibraverse.geometry.meshing.accuracy import accuracy
from vibraverse.geometry.meshing.cautions import of_wrap
from vibraverse.geometry.meshing.sizes import Body
from vibraverse.geometry.meshing.tets import mesh_body, tetrahedralise
from vibraverse.geometry.meshing.work import Spent, Work
from vibraverse.geometry.meshing.wrapped import wrapped
from vibraverse.stages import tets as stage


def refuse(*arguments):
    raise Refused("meshing_failed", "it cannot", "Mend it.")


def demands(surface, elements, most):
    return tets_module._Demands.of(*surface, elements, 0.005, 0.1, most, 0.05)


def test_a_recipe_and_all_recipes_have_a_limit_of_work():
    work = Work(100)
    work.begin()
    work.check()
    work.add(1_500)
    with pytest.raises(Spent, match="after handling 1500 triangles"):
        work.check()
    work.begin()  # the next recipe has work of its own
    work.check()
    work.add(500)
    work.begin()
    assert not work.exhausted
    work.add(500)  # the rest of what all may take
    assert work.exhausted
    with pytest.raises(Spent):
        work.check()


def test_hopeless_recipes_end_by_counts(monkeypatch):
    """Mmg's result cuts itself whatever the size: without a limit that takes up to 200 calls."""
    crossing = shapes.together(shapes.ball(0.5), shapes.ball(0.5, centre=(0.3, 0, 0)))
    calls = []

    def hopeless(vertices, faces, *more):
        calls.append(len(faces))
        return *crossing, np.zeros((0, 2), np.int64)

    monkeypatch.setattr(remesh_module, "_mmg", hopeless)
    monkeypatch.setattr(remesh_module, "_MAX_LOCAL_SHARE", 1.0)
    ball, counts = shapes.ball(0.5), []
    for _ in range(2):
        calls.clear()
        with pytest.raises(Refused, match="given up after handling"):
            tets_module._by_recipes(*ball, demands(ball, 300, 1_000))
        counts.append(list(calls))
    assert counts[0] == counts[1]
    # 25,000 triangles in all; a call that begins below the limit is the last.
    each = counts[0][0] + len(crossing[1])
    assert 15_000 < each * len(counts[0]) < 25_000 + each


def test_a_body_never_gets_more_elements_than_it_may(monkeypatch):
    ball, box = shapes.ball(0.5), shapes.box()
    points, cells = np.eye(4, 3), np.tile([[0, 1, 2, 3]], (7, 1))
    with pytest.raises(Refused, match="the body takes 7 tetrahedra; at most 6 are allowed"):
        tets_module._checked(points, cells, box, demands(box, 2, 1), {})
    monkeypatch.setattr(sizes_module, "fill", lambda *surface, optimise: (points, np.tile(cells, (1_000, 1))))
    with pytest.raises(Refused, match="the body takes 7210 tetrahedra; at most 1200 are allowed"):
        tets_module._by_recipes(*ball, demands(ball, 400, 1))


def test_where_an_envelope_takes_too_many_elements_a_wider_one_is_tried_and_else_a_narrower_one(monkeypatch):
    box, tried = shapes.box(), []

    def fails(kind):
        def fill(vertices, faces, size, envelope):
            tried.append(round(envelope / Body(*box, 400, 1_200).thickness, 3))
            raise kind("meshing_failed", "it fails")

        return fill

    for kind, envelopes in ((tets_module.TooMany, [0.1, 0.25]), (Refused, [0.1, 0.03])):
        monkeypatch.setattr(tets_module, "fill_within", fails(kind))
        tried.clear()
        with pytest.raises(Refused, match="it fails"):
            tets_module._within_envelope(*box, demands(box, 400, 1))
        assert tried == envelopes


def test_the_limit_of_elements_follows_the_target():
    box = shapes.box()
    assert demands(box, 500, 24_000).most == 24_000
    assert demands(box, 40_000, 24_000).most == 120_000


def test_a_dense_surface_is_thinned_and_the_mesh_fitted_to_the_original(monkeypatch):
    monkeypatch.setattr(sizes_module, "_SCANNED_TRIANGLES", 4_000)
    dense = repair.split(*shapes.cylinder(0.5, 1.8), 0.035)
    assert len(dense[1]) > 4 * 1_000
    body = Body(*dense, 1_000, 24_000)
    assert len(body.start[1]) < 0.5 * len(dense[1])
    monkeypatch.setattr(sizes_module, "_SCANNED_TRIANGLES", len(dense[1]))
    assert Body(*dense, 1_000, 24_000).start[1] is dense[1]  # as many triangles as a generated body may have
    monkeypatch.setattr(sizes_module, "_SCANNED_TRIANGLES", 4_000)
    assert Body(*shapes.box(), 1_000, 24_000).start[1].shape == (12, 3)
    mesh = tetrahedralise(*dense, 1_000)
    volume = tets_module.quality.volumes(mesh.points, mesh.cells).sum()
    assert volume == pytest.approx(surfaces.volume(*dense), rel=1e-9)
    assert mesh.quality["accuracy"]["surface_to_mesh"] < 0.01


def test_thinning_keeps_every_part():
    """A speck that would vanish keeps the whole surface as it is."""
    speck = shapes.together(shapes.ball(0.9), shapes.ball(0.001, 1, (0.95, 0, 0)))
    assert sizes_module.thinned(*speck, 0.01)[1] is speck[1]
    assert len(sizes_module.thinned(*shapes.ball(0.9), 0.01)[1]) < len(speck[1]) / 2


def test_ftetwild_gets_few_triangles_or_none(monkeypatch):
    given, faces = envelope._given(*shapes.ball(0.9, 5), 0.05)
    assert len(faces) < 5_000
    assert np.abs(np.linalg.norm(given, axis=1) - 0.9).max() < 0.3 * 0.05
    monkeypatch.setattr(envelope, "_MAX_TRIANGLES", 100)
    with pytest.raises(Refused, match="up to 100 triangles, and the surface keeps 1280 within"):
        envelope._given(*shapes.ball(0.9, 3), 0.001)


def test_a_wrap_keeps_cavities_and_bounds_what_changes():
    given = shapes.hollow_ball(0.9, 0.5, 4)
    surface = wrapped(*given, 0.02, 0.003, 0.05)
    assert surfaces.topology(surface[1], len(surface[0])).components == 2
    assert surfaces.volume(*surface) == pytest.approx(surfaces.volume(*given), rel=0.05)
    with pytest.raises(Refused, match=r"changes the volume by .* %, at most 0.001 % are allowed"):
        wrapped(*given, 0.02, 0.003, 1e-5)
    film = shapes.hollow_ball(0.9, 0.8999, 3)
    with pytest.raises(Refused, match="a wrap at 2 % of the diagonal makes a cavity cut the outside"):
        wrapped(*film, 0.02, 0.003, 0.05)


def test_what_nothing_fills_is_wrapped_and_the_record_and_a_warning_say_so(monkeypatch):
    given, original = shapes.hollow_ball(0.9, 0.5, 4), tets_module._by_recipes

    def only_others(vertices, faces, *more):
        return refuse() if len(faces) == len(given[1]) else original(vertices, faces, *more)

    monkeypatch.setattr(tets_module, "_by_recipes", only_others)
    monkeypatch.setattr(tets_module, "_within_envelope", refuse)
    mesh = tetrahedralise(*given, 1_000)
    assert mesh.quality["wrap"] == {"radius": 0.01, "offset": 0.002}
    change = mesh.quality["accuracy"]["volume_change"]
    true = tets_module.quality.volumes(mesh.points, mesh.cells).sum() / surfaces.volume(*given) - 1
    assert change == pytest.approx(true, rel=0.01)
    assert 0 < abs(change) < 0.05
    assert 0 < mesh.quality["accuracy"]["mesh_to_surface"] < 0.02
    assert of_wrap({}) == []
    assert (
        f"it was wrapped at 1 % of the diagonal, which changed the volume by {100 * change:+.2g} %"
        in " ".join(of_wrap(mesh.quality))
    )
    with pytest.raises(Refused, match=r"Wrapping: tets\.max_wrap_change is 0"):
        tetrahedralise(*given, 1_000, max_wrap_change=0)


def test_the_record_says_what_meshing_cost():
    cube = shapes.box()
    assert set(accuracy(cube, cube).values()) == {0.0}
    coarse, fine = shapes.ball(0.9, 1), shapes.ball(0.9, 5)
    found, diagonal = accuracy(fine, coarse), 1.8 * 3**0.5
    assert found["volume_change"] == pytest.approx(
        surfaces.volume(*coarse) / surfaces.volume(*fine) - 1, rel=0.01
    )
    # A sphere's farthest point from the chords is above the middle of a triangle.
    deepest = 0.9 - np.linalg.norm(coarse[0][coarse[1]].mean(axis=1), axis=1).min()
    assert found["surface_to_mesh"] == pytest.approx(deepest / diagonal, rel=0.03)
    assert found["mesh_to_surface"] == pytest.approx(deepest / diagonal, rel=0.03)
    assert 0 < found["mean_mesh_to_surface"] < found["mesh_to_surface"]


def said(number: int) -> int:
    report(f"half of {number}")
    return number // 2


def kill(*arguments):
    os.kill(os.getpid(), signal.SIGKILL)


def hang(*arguments):
    time.sleep(60)


def test_reports_of_a_child_reach_whoever_listens(capsys):
    heard = []
    with reports_to(heard.append):
        assert run_limited(said, 4, seconds=60, memory_mb=500, what="it") == 2
    assert heard == ["half of 4"]
    run_limited(said, 6, seconds=60, memory_mb=500, what="it")
    assert capsys.readouterr().err == "half of 6\n"


def test_a_mesher_that_is_killed_leaves_the_body_to_the_next(monkeypatch, capsys):
    monkeypatch.setattr(tets_module, "_by_recipes", kill)
    assert mesh_body(*shapes.box(), Tets(target_elements=300)).quality["algorithm"] == "ftetwild"
    assert "gmsh with Mmg failed: gmsh with Mmg was killed from outside" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("end", "seconds", "words"), [(kill, 300, "was killed from outside"), (hang, 2, "was stopped")]
)
def test_meshers_that_all_end_badly_leave_no_half_written_product(tmp_path, monkeypatch, end, seconds, words):
    for way in ("_by_recipes", "_within_envelope", "_by_wraps"):
        monkeypatch.setattr(tets_module, way, end)
    surface = tmp_path / "surface.ply"
    meshes.write_ply(surface, *shapes.box())
    final = {"tets": tmp_path / "out/tets.msh", "record": tmp_path / "out/tets.json"}
    options = Tets(limits={"seconds": seconds})
    job = Job(BY_NAME["tets"], "mine", "solid", {"surface": surface}, final, options)
    run(job, stage.run, ["vibraverse", "tets"])
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["tets.json", "tets.msh"]
    for path in final.values():
        refusal = read_refusal(path)
        for tool in ("gmsh with Mmg", "fTetWild", "Wrapping"):
            assert f"{tool} {words}" in refusal.message


def test_the_log_of_the_stage_says_how_the_recipes_go(vibraverse, tmp_path):
    meshes.write_ply(tmp_path / "surface.ply", *shapes.ball(subdivisions=3))
    status, _, log = vibraverse(
        *("tets", "--object", "mine", "--solidity", "solid", "--surface", tmp_path / "surface.ply"),
        *("--tets", tmp_path / "t.msh", "--record", tmp_path / "t.json"),
        *("--options", json.dumps({"target_elements": 500})),
    )
    assert status == 0, log
    assert "remeshing, sharp above 35°\n" in log
    assert " tetrahedra, 500 wanted\n" in log
    found = products.read_json(tmp_path / "t.json")["quality"]
    assert set(found["accuracy"]) == {
        "surface_to_mesh", "mesh_to_surface", "mean_mesh_to_surface", "volume_change"
    }  # fmt: skip
    assert "wrap" not in found


@pytest.mark.parametrize(
    "name",
    [
        "bodies-fused-by-wrap/six-boxes-1mm-apart.stl",
        "glb-centimetres-as-metres/bar-300.gltf",
        "gltf-skin-node-transform/skinned-bar.gltf",
        "obj-utf16/box-utf16be.obj",
        "stray-flat-part/box-above-ground-plane.stl",
        "stray-flat-part/box-and-stray-triangle.stl",
    ],
)
def test_closed_solids_from_reports_become_tetrahedra(shared_cases, name):
    mesh = meshes.read_mesh(shared_cases / name)
    body = clean(mesh.vertices, mesh.faces)
    found = tetrahedralise(body.vertices, body.faces, 400)
    volume = tets_module.quality.volumes(found.points, found.cells).sum()
    assert volume == pytest.approx(surfaces.volume(body.vertices, body.faces), rel=5e-3)
    assert found.quality["accuracy"]["surface_to_mesh"] < 0.01
