"""tets: volumes, features, quality and validity of meshes, and the stage's products."""

from __future__ import annotations

import json
import os
import re
import signal

import meshio
import numpy as np
import pytest

import shapes
from vibraverse.config.geometry import Tets
from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import read_refusal
from vibraverse.files import meshes
from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.meshing import quality
from vibraverse.geometry.meshing import remesh as remesh_module
from vibraverse.geometry.meshing import sizes as sizes_module
from vibraverse.geometry.meshing import tets as tets_module
from vibraverse.geometry.meshing.fill import fill, ordered
from vibraverse.geometry.meshing.remesh import EvenSurface, SheetsMeet, remesh
from vibraverse.geometry.meshing.ridges import ridges
from vibraverse.geometry.meshing.tets import mesh_body, tetrahedralise

TARGET = 2000


def check_mesh(mesh, vertices, faces, target=TARGET):
    """Assert what holds for every mesh of a body."""
    volumes = quality.volumes(mesh.points, mesh.cells)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(surfaces.volume(vertices, faces), rel=1e-9)
    assert np.array_equal(np.unique(mesh.cells), np.arange(len(mesh.points)))
    assert quality.parts(mesh.cells, len(mesh.points)) == 1
    assert 0.7 * target < len(mesh.cells) < 1.35 * target
    # The boundary of the tetrahedra is closed: every face belongs to two of them or to the surface.
    triangles = np.sort(mesh.cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    _, count = np.unique(triangles, axis=0, return_counts=True)
    assert count.max() == 2
    assert mesh.quality["min_dihedral_deg"]["p05"] > 15


def test_a_cube_stays_a_cube():
    vertices, faces = shapes.box()
    mesh = tetrahedralise(vertices, faces, TARGET)
    check_mesh(mesh, vertices, faces)
    assert np.abs(mesh.points).max() == pytest.approx(0.9, abs=1e-15)
    for corner in vertices:
        assert (np.linalg.norm(mesh.points - corner, axis=1) < 1e-12).sum() == 1
    assert mesh.quality["min_dihedral_deg"]["min"] > 10


def test_a_ball_keeps_volume_and_inertia():
    vertices, faces = shapes.ball(subdivisions=5)
    mesh = tetrahedralise(vertices, faces, TARGET)
    check_mesh(mesh, vertices, faces)
    # Second moments of the tetrahedra: those of the ball are V R²/5 along every axis.
    volumes = quality.volumes(mesh.points, mesh.cells)
    corner = mesh.points[mesh.cells]
    moments = ((corner**2).sum(axis=1) + corner.sum(axis=1) ** 2) / 20
    assert np.allclose(volumes @ moments, volumes.sum() * 0.9**2 / 5, rtol=5e-3)


def test_a_cylinder_keeps_its_rims():
    vertices, faces = shapes.cylinder(0.5, 1.8)
    mesh = tetrahedralise(vertices, faces, TARGET)
    check_mesh(mesh, vertices, faces)
    assert np.abs(mesh.points[:, 2]).max() == pytest.approx(0.9, abs=2e-3)
    rim = mesh.points[np.abs(np.abs(mesh.points[:, 2]) - 0.9) < 2e-3]
    assert np.hypot(*rim.T[:2]).max() == pytest.approx(0.5, abs=8e-3)


def test_a_cavity_stays_empty():
    vertices, faces = shapes.hollow_ball(0.9, 0.5)
    mesh = tetrahedralise(vertices, faces, TARGET)
    check_mesh(mesh, vertices, faces)
    middles = mesh.points[mesh.cells].mean(axis=1)
    assert np.linalg.norm(middles, axis=1).min() > 0.5
    assert np.linalg.norm(mesh.points, axis=1).min() == pytest.approx(0.5, abs=0.02)


def test_several_cavities_are_all_left_out():
    outside = shapes.box((1.8, 0.8, 0.8))
    holes = [shapes.ball(0.25, 3, (x, 0, 0)) for x in (-0.5, 0.5)]
    vertices, faces = shapes.together(outside, *((points, cells[:, ::-1]) for points, cells in holes))
    check_mesh(tetrahedralise(vertices, faces, TARGET), vertices, faces)


def test_walls_thinner_than_the_triangles_are_meshed():
    vertices, faces = shapes.hollow_ball(0.9, 0.84, subdivisions=4)
    mesh = tetrahedralise(vertices, faces, 4000)
    volumes = quality.volumes(mesh.points, mesh.cells)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(surfaces.volume(vertices, faces), rel=5e-3)


def test_walls_far_thinner_than_the_elements_asked_for_are_meshed_finer():
    vertices, faces = shapes.hollow_ball(0.9, 0.86, subdivisions=4)
    mesh = tetrahedralise(vertices, faces, 200)
    assert quality.volumes(mesh.points, mesh.cells).min() > 0
    assert len(mesh.cells) > 8 * 200
    assert any(f"{len(mesh.cells)} tetrahedra" in warning for warning in mesh.warnings)


def test_the_same_surface_gives_the_same_bits():
    vertices, faces = shapes.hollow_ball(0.9, 0.5)
    one, two = (tetrahedralise(vertices, faces, 1000) for _ in range(2))
    assert np.array_equal(one.points, two.points)
    assert np.array_equal(one.cells, two.cells)
    assert one.quality == two.quality


def test_points_that_share_a_tetrahedron_are_near_each_other_in_memory():
    """The speed of the solver's sparse products depends on it. gmsh numbers the surface first, then the inside."""
    nodes, cells = fill(*shapes.ball(subdivisions=3), optimise=False)
    points, tetrahedra = ordered(nodes, cells)
    span = np.ptp(tetrahedra, axis=1)
    assert span.max() < 0.5 * len(points) < np.ptp(cells, axis=1).max()
    assert (np.diff(tetrahedra.min(axis=1)) >= 0).all()
    # The same tetrahedra, turned the same way.
    assert np.allclose(
        np.sort(quality.volumes(points, tetrahedra)), np.sort(quality.volumes(nodes, cells)), rtol=1e-12
    )
    middles = [
        np.unique(np.round(p[c].mean(axis=1), 9), axis=0) for p, c in ((nodes, cells), (points, tetrahedra))
    ]
    assert np.array_equal(*middles)


def test_a_child_process_gives_the_same_mesh():
    vertices, faces = shapes.box()
    child = mesh_body(vertices, faces, Tets(target_elements=500))
    here = tetrahedralise(vertices, faces, 500)
    assert np.array_equal(child.points, here.points)
    assert np.array_equal(child.cells, here.cells)


def test_remeshing_bounds_the_distance_from_the_original():
    vertices, faces = shapes.ball(subdivisions=5)
    points, triangles = remesh(vertices, faces, 0.2, 0.02)
    assert surfaces.topology(triangles, len(points)).closed_manifold
    assert surfaces.volume(points, triangles) == pytest.approx(surfaces.volume(vertices, faces), rel=1e-12)
    middles = points[triangles].mean(axis=1)
    assert np.abs(np.linalg.norm(middles, axis=1) - 0.9).max() < 0.06 * 0.2
    assert surfaces.edge_lengths(points, triangles).max() < 2 * 0.2


def test_a_blemish_that_mmg_leaves_is_mended(monkeypatch):
    body, deviation = shapes.ball(0.5), 0.01
    mmg, wanted = remesh_module._mmg, []

    def blemished(vertices, faces, sizes, *more):
        wanted.append(sizes)
        points, triangles, edges = mmg(vertices, faces, sizes, *more)
        if len(wanted) == 1:
            points[0] *= 0.5
        return points, triangles, edges

    monkeypatch.setattr(remesh_module, "_mmg", blemished)
    points, _ = remesh(*body, 0.1, deviation)
    assert len(wanted) == 2
    finer = wanted[1] < wanted[0]
    assert 0 < finer.mean() < 0.1
    assert np.abs(np.linalg.norm(points, axis=1) - 0.5).max() < 2 * deviation


def test_far_too_many_triangles_are_not_made(monkeypatch):
    body, calls = shapes.ball(0.5), []
    mmg = remesh_module._mmg
    monkeypatch.setattr(remesh_module, "_mmg", lambda *a: calls.append(len(a[1])) or mmg(*a))
    with pytest.raises(SheetsMeet, match=r"the remeshed surface would have \d+ triangles"):
        remesh(*body, 0.005, 0.001, most=100_000)
    assert not calls
    # The even surface is skipped, and the surface remeshed from its own triangles.
    fine = EvenSurface(*body, 0.1, lambda points, size: np.full(len(points), size), 0.01, 35.0, most=2_000)
    assert not calls
    assert len(fine.remesh(0.1, 0.01)[1]) < 2_000
    assert calls


def test_a_blemish_is_not_mended_at_any_price(monkeypatch):
    """Every round doubles the triangles and keeps the blemish; the result must be that of the first round."""
    rounds = []

    def blemished(vertices, faces, sizes, *_):
        points, triangles = repair.split(*shapes.ball(0.5), 0.04 / 2 ** (len(rounds) / 2))
        rounds.append(len(triangles))
        points[0] *= 0.5
        return points, triangles, np.zeros((0, 2), np.int64)

    monkeypatch.setattr(remesh_module, "_mmg", blemished)
    _, triangles = remesh(*shapes.ball(0.5), 0.1, 0.01)
    assert len(triangles) == max(count for count in rounds if count <= 3 * rounds[0])
    assert rounds[-1] > 3 * rounds[0]


def test_a_later_size_that_fails_does_not_lose_an_earlier_one(monkeypatch):
    original, sizes = sizes_module.Body.remesh, []

    def failing(self, size, ridge_deg):
        sizes.append((size, ridge_deg))
        if len(sizes) > 1:
            raise RuntimeError("Mmg gave up")
        return original(self, 2 * size, ridge_deg)  # far too few elements, so that another size is tried

    monkeypatch.setattr(sizes_module.Body, "remesh", failing)
    mesh = tetrahedralise(*shapes.ball())
    assert len(sizes) == 2
    assert mesh.quality["ridge_deg"] == 35.0


def test_where_the_fit_makes_sheets_cut_each_other_it_may_yield(monkeypatch):
    balls = shapes.together(shapes.ball(0.4, 3, (-0.42, 0, 0)), shapes.ball(0.4, 3, (0.42, 0, 0)))

    def pushed(closest, wanted, points, triangles, tolerated):
        near = np.abs(points[:, :1]) < 0.08
        return points - near * np.sign(points[:, :1]) * [0.05, 0.0, 0.0]

    monkeypatch.setattr(remesh_module, "fit_to", pushed)
    even = EvenSurface(*balls, 0.1, lambda points, size: np.full(len(points), size), 0.01, 35.0)
    with pytest.raises(SheetsMeet):
        even.remesh(0.1, 0.01)
    points, triangles = even.remesh(0.1, 0.01, yielding=True)
    assert surfaces.topology(triangles, len(points)).components == 2
    assert not crossing_faces(points, triangles).any()


def refuse(vertices, faces, demands):
    raise Refused("meshing_failed", "fTetWild: sheets are close.", "Mend it.")


def test_where_no_recipe_works_ftetwild_fills_the_body(monkeypatch, tmp_path):
    monkeypatch.setattr(tets_module, "_by_recipes", refuse)
    monkeypatch.chdir(tmp_path)
    vertices, faces = shapes.hollow_ball(0.9, 0.5)
    mesh = tetrahedralise(vertices, faces, TARGET)
    check_mesh(mesh, vertices, faces, len(mesh.cells))
    assert (mesh.quality["algorithm"], mesh.quality["ridge_deg"]) == ("ftetwild", None)
    radii = np.linalg.norm(mesh.points, axis=1)
    assert radii.min() == pytest.approx(0.5, abs=0.03)
    assert radii.max() == pytest.approx(0.9, abs=0.03)
    assert not list(tmp_path.iterdir())


def crash(*arguments):
    os.kill(os.getpid(), signal.SIGSEGV)


def test_a_mesher_that_crashes_leaves_the_body_to_the_next(monkeypatch):
    monkeypatch.setattr(tets_module, "_by_recipes", crash)
    assert mesh_body(*shapes.box(), Tets(target_elements=500)).quality["algorithm"] == "ftetwild"


def test_a_body_that_nothing_fills_is_refused_with_what_each_tool_said(monkeypatch):
    monkeypatch.setattr(tets_module, "_by_recipes", crash)
    monkeypatch.setattr(tets_module, "_within_envelope", refuse)
    monkeypatch.setattr(tets_module, "_by_wraps", crash)
    with pytest.raises(Refused) as caught:
        mesh_body(*shapes.box(), Tets(target_elements=500))
    assert caught.value.reason == "meshing_failed"
    assert re.match(
        r"Nothing filled .* gmsh with Mmg crashed \(SIGSEGV\)\. fTetWild: .*close\. Wrapping crashed \(SIGSEGV\)\.$",
        caught.value.message,
    )
    assert "Repair or simplify the mesh" in caught.value.advice


def test_elements_shrink_towards_a_reentrant_edge():
    vertices, faces = shapes.angle_bracket()
    mesh = tetrahedralise(vertices, faces, TARGET)
    check_mesh(mesh, vertices, faces)
    volumes, middles = quality.volumes(mesh.points, mesh.cells), mesh.points[mesh.cells].mean(axis=1)
    # The re-entrant edge runs along x = z = 0; the outer edges at x, z = -0.6 get no such care.
    inner = np.hypot(middles[:, 0], middles[:, 2]) < 0.1
    outer = np.hypot(middles[:, 0] + 0.6, middles[:, 2] + 0.6) < 0.1
    assert inner.sum() > 20
    assert np.median(volumes[inner]) < 0.6 * np.median(volumes[outer])


def test_ridges_shorter_than_elements_are_roughness():
    vertices, faces = shapes.box()
    edges = ridges(vertices, faces, 35.0)
    assert len(edges) == 12
    assert len(ridges(vertices, faces, 95.0)) == 0
    # A small pyramid on one face: its four slopes make ridges that end where it does.
    top = len(vertices)
    corners = np.array([[x, y, 0.9] for x, y in ((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1))])
    rough = np.concatenate([vertices, corners, [[0.0, 0.0, 1.0]]])
    pyramid = np.array([[top + i, top + (i + 1) % 4, top + 4] for i in range(4)])
    base = np.array([[top, top + 2, top + 1], [top, top + 3, top + 2]])
    both = np.concatenate([faces, pyramid, base])
    assert len(ridges(rough, both, 35.0)) == 12 + 4 + 4
    assert len(ridges(rough, both, 35.0, shortest=0.5)) == 12
    assert len(ridges(rough, both, 35.0, shortest=0.2)) == 12 + 4 + 4


def test_how_thin_walls_are_is_a_number_and_no_warning():
    thick, thin = tetrahedralise(*shapes.box(), TARGET), tetrahedralise(*shapes.box((1.8, 1.8, 0.03)), TARGET)
    assert not thick.warnings
    assert thin.quality["layers"]["median"] < 1 < 3 < thick.quality["layers"]["median"]
    assert thin.quality["layers"]["thin_share"] > 0.9
    assert not thin.warnings


def test_a_mesh_below_the_asked_quality_is_refused():
    vertices, faces = shapes.cylinder(0.5, 1.8)
    with pytest.raises(Refused, match="degrees between two faces"):
        tetrahedralise(vertices, faces, 300, min_dihedral_deg=45.0)


def test_sheets_that_cut_each_other_are_noticed():
    a, b = shapes.ball(0.5, 3), shapes.ball(0.5, 3, (0.3, 0, 0))
    with pytest.raises(SheetsMeet):
        remesh(*shapes.together(a, b), 0.2, 0.02)


def test_a_surface_that_cuts_itself_is_refused():
    a, b = shapes.ball(0.5, 3), shapes.ball(0.5, 3, (0.3, 0, 0))
    with pytest.raises(Refused) as refused:
        tetrahedralise(*shapes.together(a, b), 500)
    assert refused.value.reason == "meshing_failed"
    assert refused.value.advice


def test_gmsh_failures_carry_its_words():
    vertices, faces = shapes.box()
    with pytest.raises(Refused) as refused:
        fill(vertices, faces[2:])
    assert refused.value.reason == "meshing_failed"
    assert "gmsh" in refused.value.message


def test_a_timeout_is_a_refusal():
    with pytest.raises(Refused) as refused:
        mesh_body(*shapes.ball(subdivisions=6), Tets(target_elements=500_000, limits={"seconds": 1}))
    assert refused.value.reason == "limit"


def test_quality_of_a_regular_and_a_flat_tetrahedron():
    regular = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    flat = regular * [1, 1, 1e-3]
    cells = np.array([[0, 1, 2, 3]])
    if quality.volumes(regular, cells)[0] < 0:
        cells = cells[:, [1, 0, 2, 3]]
    assert quality.volumes(regular, cells)[0] == pytest.approx(8 / 3)
    assert quality.min_dihedral_deg(regular, cells)[0] == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert quality.radius_ratios(regular, cells)[0] == pytest.approx(1.0)
    assert quality.min_dihedral_deg(flat, cells)[0] < 0.2
    assert quality.radius_ratios(flat, cells)[0] < 1e-2


@pytest.mark.parametrize("solidity", ["solid", "hollow"])
def test_the_stage_writes_tetrahedra_and_their_quality(vibraverse, tmp_path, solidity):
    vertices, faces = shapes.ball(subdivisions=3) if solidity == "solid" else shapes.hollow_ball()
    meshes.write_ply(tmp_path / "surface.ply", vertices, faces)
    products = []
    for name in ("one", "two"):
        status, _, errors = vibraverse(
            *("tets", "--object", "mine", "--solidity", solidity, "--surface", tmp_path / "surface.ply"),
            *("--tets", tmp_path / f"{name}.msh", "--record", tmp_path / f"{name}.json"),
            *("--options", json.dumps({"target_elements": 800})),
        )
        assert status == 0, errors
        products.append([(tmp_path / f"{name}.{end}").read_bytes() for end in ("msh", "json")])
    assert products[0] == products[1]
    mesh = meshio.read(tmp_path / "one.msh")
    said = json.loads(products[0][1])
    assert [block.type for block in mesh.cells] == ["tetra"]
    assert (said["vertices"], said["tetrahedra"]) == (len(mesh.points), len(mesh.cells[0].data))
    assert quality.volumes(mesh.points, mesh.cells[0].data).sum() == pytest.approx(said["volume"])
    assert said["volume"] == pytest.approx(said["surface_volume"], rel=1e-9)
    assert said["quality"]["radius_ratio"]["median"] > 0.5


def test_the_stage_refuses_what_it_cannot_fill(vibraverse, tmp_path):
    a, b = shapes.ball(0.5, 3), shapes.ball(0.5, 3, (0.3, 0, 0))
    meshes.write_ply(tmp_path / "surface.ply", *shapes.together(a, b))
    status, _, errors = vibraverse(
        *("tets", "--object", "mine", "--solidity", "solid", "--surface", tmp_path / "surface.ply"),
        *("--tets", tmp_path / "t.msh", "--record", tmp_path / "t.json"),
    )
    assert status == 0
    assert "Traceback" not in errors
    assert read_refusal(tmp_path / "t.msh").reason == "meshing_failed"
