"""The validation: its own numbers against the literature, the comparison, the table, the verdict and the page."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from meshes import box
from vibraverse.contract import products
from vibraverse.contract.refusal import Refusal
from vibraverse.dataset.schema.tables import from_tsv
from vibraverse.geometry import surfaces
from vibraverse.physics.materials import lame
from vibraverse.validation import spectra, table
from vibraverse.validation.bodies import BODIES
from vibraverse.validation.meshes import meshes, surface
from vibraverse.validation.references import PUBLISHED, references
from vibraverse.validation.study import compare, study
from workflow_runs import Run


def shear_speed(poisson):
    return np.sqrt(lame(1.0, poisson)[1])


#: ω a / c_s of the free ball by Poisson's ratio, as published many times.
PUBLISHED_BALL = {
    0.20: {"T2": 2.50113, "T3": 3.86470, "S2": 2.63270, "S0": 4.01804},
    0.25: {"T2": 2.50113, "T3": 3.86470, "S2": 2.63987, "S0": 4.44000},
    0.30: {"T2": 2.50113, "T3": 3.86470, "S2": 2.64622, "S0": 4.99551},
    0.35: {"T2": 2.50113, "T3": 3.86470, "S2": 2.65187, "S0": 5.78948},
}


@pytest.mark.parametrize("poisson", PUBLISHED_BALL)
def test_characteristic_equations_of_the_ball(poisson):
    found = spectra.spherical(poisson, 6.0)
    for name, value in PUBLISHED_BALL[poisson].items():
        assert found[name] == pytest.approx(value, abs=6e-6)
    assert list(found.values()) == sorted(found.values())


def octant_of_a_shell(cavity: float, count: int = 14):
    """Gauss's points of the octant of a shell of outer radius 1."""
    t, w = np.polynomial.legendre.leggauss(count)
    t, w = (t + 1) / 2, w / 2
    r, z, angle = np.meshgrid(cavity + (1 - cavity) * t, t, np.pi / 2 * t, indexing="ij")
    flat = np.sqrt(1 - z**2)
    points = np.stack([r * flat * np.cos(angle), r * flat * np.sin(angle), r * z], axis=-1).reshape(-1, 3)
    weights = np.einsum("i,j,k->ijk", w * (1 - cavity), w, w * np.pi / 2) * r**2
    return points, weights.ravel()


@pytest.mark.parametrize(("cavity", "limit", "accuracy"), [(0.0, 4.0, 1e-5), (0.8, 2.35, 1e-3)])
def test_two_ways_to_the_same_spectrum(cavity, limit, accuracy):
    """Bessel functions and polynomials share nothing; together they also show that no multiplet is left out."""
    exact = spectra.spherical(0.3, limit, cavity)
    every = np.repeat(list(exact.values()), [2 * int(name[1:].rstrip("'")) + 1 for name in exact])
    inside = octant_of_a_shell(cavity)
    found = spectra.ritz(inside, np.ones(3), (12, 12, 12), 0.3, len(every)) / shear_speed(0.3)
    assert found == pytest.approx(every, rel=accuracy)
    assert (found > every * (1 - 1e-9)).all()


def test_the_cube_of_the_literature():
    found = spectra.box((1, 1, 1), (12, 12, 12), 0.3, 17) / shear_speed(0.3)
    expected = np.repeat([2.8561, 3.8460, 3.9113, 4.4429, 4.5728, 4.7926], [2, 3, 3, 3, 3, 3])
    assert found == pytest.approx(expected, abs=6e-5)
    assert found[8:11] == pytest.approx(np.pi * np.sqrt(2), rel=1e-6)  # Lamé's modes, for every ν


def test_a_cylinder_twists_as_it_must():
    found = spectra.cylinder(0.05, 0.13, 10, 0.3, 20) / shear_speed(0.3)
    assert abs(found / (np.pi / 0.13) - 1).min() < 1e-9


def test_bar_plate_and_block_of_the_literature():
    bar = [line.hz for line in references(BODIES["bar"], 0.3)]
    for bending in (254.7, 691.2, 1325.6):
        assert min(abs(hz / bending - 1) for hz in bar) < 1e-3
    for name, largest in (("plate", 0.012), ("block", 0.006)):
        (poisson,) = BODIES[name].poissons
        lines = references(BODIES[name], poisson)
        computed = np.concatenate([[line.hz] * line.count for line in lines if not line.published])
        assert computed == pytest.approx(PUBLISHED[name].hz, rel=largest)


@pytest.mark.parametrize("name", BODIES)
def test_references_leave_no_frequency_out(name):
    body = BODIES[name]
    for poisson in body.poissons:
        computed = [line for line in references(body, poisson) if not line.published]
        assert [line.first for line in computed] == list(
            np.cumsum([0, *(line.count for line in computed)])[:-1]
        )
        assert all(a.hz < b.hz for a, b in pairwise(computed))


def test_surfaces_enclose_the_volume_of_the_true_body():
    for body in BODIES.values():
        vertices, faces = surface(body)
        lengths = body.lengths_m
        expected = {
            "ball": lambda r: 4 / 3 * np.pi * r**3,
            "box": lambda *sides: np.prod(sides),
            "cylinder": lambda r, h: np.pi * r**2 * h,
        }[body.kind](*lengths)
        assert surfaces.volume(vertices, faces) == pytest.approx(expected, rel=1e-12)
        assert surfaces.topology(faces, len(vertices)).closed_manifold


def test_the_hollow_ball_goes_through_the_stages():
    body = replace(BODIES["hollow-ball"], elements=(600,), finer=())
    scale_m, (mesh,) = meshes(body)
    assert scale_m == pytest.approx(0.2 / 1.8, rel=1e-3)
    corners = mesh.points[mesh.cells] * scale_m
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 0.1**3 * (1 - 0.6**3), rel=0.01)
    rows = study(body, [(mesh.points, mesh.cells)], scale_m)
    quadratic = [row for row in rows if row["order"] == 2]
    assert max(abs(row["relative_error"]) for row in quadratic if row["mode"] in ("S2", "T2")) < 0.02


@pytest.fixture(scope="module")
def cube():
    """The rows of a cube on three coarse meshes, the last for order 1 alone."""
    body = replace(BODIES["cube"], tolerances={1: (0.25, 0.1), 2: (0.02, 0.004)}, elements=(1, 2), finer=(3,))
    return study(body, [box((0.1, 0.1, 0.1), (n, n, n)) for n in (3, 5, 7)], 1.0)


def test_both_orders_are_held_against_the_cube(cube):
    judged = [row for row in cube if row["tolerance"] is not None]
    assert {row["verdict"] for row in judged} == {"met"}
    assert {row["unknowns"] for row in judged} == {3 * 8**3, 3 * 11**3}
    assert {row["order"] for row in cube} == {1, 2}
    assert table.missed(cube) == []
    for kind in ("P1", "P1 corrected", "P2", "P2 corrected"):
        assert sum(row["equal"] for row in judged if table.elements(row) == kind) == BODIES["cube"].modes


def test_errors_fall_with_the_power_they_must(cube):
    curves = table.convergence(cube)
    assert [len(curves[kind]["unknowns"]) for kind in ("P1", "P2")] == [3, 2]
    assert -0.9 < curves["P1"]["slope"] < -0.45
    assert -1.7 < curves["P2"]["slope"] < -0.9
    assert curves["P2"]["errors"][-1] < 0.1 * curves["P1"]["errors"][-1]
    for order in ("P1", "P2"):
        assert curves[f"{order} corrected"]["errors"][-1] < 0.3 * curves[order]["errors"][-1]


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_a_planted_wrong_value_is_missed(factor):
    line = replace(references(BODIES["cube"], 0.3)[1], hz=1000.0 * factor)
    hz = np.full(30, 1000.0)
    assert compare(line, hz, 0.02)["verdict"] == "missed"
    assert compare(line, hz, 0.04)["verdict"] == "met"
    assert compare(line, hz, None)["verdict"] == "shown"
    hz[line.first + 1] *= 1.05  # of equal frequencies the worst one speaks
    assert compare(replace(line, hz=1000.0), hz, 0.02)["verdict"] == "missed"


@pytest.fixture
def validated(tmp_path, cube):
    """Writes the comparisons of two bodies, runs the stage and returns its record's path and the command's result."""

    def make(vibraverse, rows=cube, second=None):
        first, other = tmp_path / "cube.json", tmp_path / "bar.json"
        products.write_json(first, {"body": "cube", "rows": rows})
        products.write_text(other, second or json.dumps({"body": "bar", "rows": rows}))
        paths = [tmp_path / name for name in ("validation.tsv", "validation.json", "convergence.svg")]
        arguments = zip(("--table", "--record", "--plot"), paths, strict=True)
        status, _, err = vibraverse(
            "validation_table", "--comparisons", first, other, *(a for pair in arguments for a in pair)
        )
        assert status == 0, err
        verdict = tmp_path / "verdict.json"
        return paths, vibraverse("validation", "--record", paths[1], "--verdict", verdict), verdict

    return make


def test_the_verdict_on_what_is_met(validated, vibraverse, cube):
    (tsv, _, svg), (status, out, _), verdict = validated(vibraverse)
    assert status == 0
    assert "All within their tolerances." in out
    assert products.read_json(verdict) == {"accepted": True, "missed": []}
    rows = from_tsv(tsv.read_text(), table.COLUMNS)
    assert len(rows) == 2 * len(cube)
    assert {row["verdict"] for row in rows} == {"met", "shown"}
    assert svg.read_text().startswith("<svg")


def test_a_missed_tolerance_fails_loudly(validated, vibraverse, cube):
    wrong = [dict(row) for row in cube]
    row = next(row for row in wrong if row["tolerance"] is not None and table.elements(row) == "P2")
    row |= {"relative_error": 0.05, "computed_hz": 1.05 * row["reference_hz"], "verdict": "missed"}
    _, (status, out, _), verdict = validated(vibraverse, wrong)
    assert status == 1
    assert f"cube, mode {row['mode']}, Poisson's ratio 0.3, P2:" in out
    assert "is off by 5 %, and 2 % is accepted" in out
    assert products.read_json(verdict)["accepted"] is False


def test_a_refused_body_fails_too(validated, vibraverse):
    refusal = Refusal("bar", "validation_meshes", "meshing_failed", "Nothing came of it.")
    _, (status, out, _), _ = validated(vibraverse, second=refusal.to_text())
    assert status == 1
    assert "bar, refused by validation_meshes: Nothing came of it." in out


def test_the_command_says_what_to_do_first(vibraverse, tmp_path):
    status, _, err = vibraverse("validation", "--record", tmp_path / "none.json")
    assert status == 2
    assert "snakemake validation" in err


def test_the_rule_plans_a_job_for_each_body(tmp_path, root):
    run = Run(tmp_path, root)
    jobs = run.plan("validation")[0]
    expected = {"validation_meshes": len(BODIES), "validation_modes": len(BODIES)}
    assert jobs == {**expected, "validation_table": 1, "validation": 1}
