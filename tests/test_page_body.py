"""What the page knows of a body: decoded and struck in JavaScript, it is what the workflow computes."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

import shapes
from meshes import box
from scripts import run_script
from vibraverse.contract.products import hdf5, sha256, write_provenance
from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.contract.seeds import rng
from vibraverse.files.basis import write_basis
from vibraverse.geometry import outside, surfaces
from vibraverse.physics.basis import build_basis
from vibraverse.physics.impulse import contact, impact_sound
from vibraverse.physics.materials import MATERIALS
from vibraverse.physics.modes import solve_material
from vibraverse.physics.shapes import mode_shapes
from vibraverse.physics.stops import build_stops
from vibraverse.report.body import body_data, measured_error
from vibraverse.report.packing import call, packed, quantised, unpacked

NAMED = ("steel", "glass", "wood")
MODES = 20
SCALE_M = 0.08
#: Where the box is struck: on faces, on an edge, at a corner.
POINTS = [(0.9, 0.2, 0.1), (0.31, -0.6, 0.2), (-0.5, 0.33, 0.35), (0.9, 0.6, 0.1), (-0.9, -0.6, -0.35)]


@pytest.fixture(scope="module")
def basis():
    points, cells = box((1.8, 1.2, 0.7), (6, 4, 3))
    return build_basis(points - [0.9, 0.6, 0.35], cells, rng=rng("p"), modes=MODES)


def served(*names: str) -> dict:
    return {name: {**MATERIALS[name], "solved_directly": False} for name in names}


@pytest.fixture(scope="module")
def data(basis):
    return body_data(basis, served(*NAMED), MODES, True, np.random.default_rng(3))


def test_a_node_is_what_its_columns_make(basis):
    stops = build_stops(basis, [0.29, 0.2], 200, MODES)
    assert len(stops.nodes) == 13
    assert set(stops.nodes) >= {0.1, 0.2, 0.29, 0.4}
    assert set(np.round(stops.poisson, 2)) == {round(0.01 * number, 2) for number in range(10, 41)}
    fields = np.concatenate([basis.surface, basis.correction_surface], axis=2).astype(float)
    for place, node in enumerate(stops.nodes):
        made = fields @ stops.columns @ stops.rotations[place].T
        true = fields @ stops.solved[int(np.searchsorted(stops.poisson, node))].coefficients
        assert np.abs(made - true).max() < 1e-3 * np.abs(true).max()


def test_fewer_columns_lose_little(basis):
    """The part of a mode outside the columns is what its row of the rotation lacks of length 1."""
    lost = [
        1 - (build_stops(basis, [0.29], columns, MODES).rotations ** 2).sum(axis=2).min()
        for columns in (24, 36)
    ]
    assert lost[1] < lost[0] < 0.1
    assert lost[1] < 2e-3


def test_frequencies_at_stops_and_materials_are_exact(basis, data):
    """Decoded and scaled in JavaScript they equal those of the solver to 1e-9."""
    body = """
      const body = await unpack.body(given.data);
      return given.wanted.map(({poisson, material}) => {
        const stop = body.poisson.indexOf(poisson);
        return stop < 0 ? [] : synth.inMaterial(unpack.angular(body, stop), material, given.scale);
      });
    """
    materials = [*MATERIALS.values(), *({**MATERIALS["steel"], "poisson": one} for one in (0.1, 0.33, 0.4))]
    wanted = [
        {
            "poisson": one["poisson"],
            "material": {
                "young": one["young_pa"],
                "density": one["density_kg_m3"],
                "alpha": one["alpha_per_s"],
                "beta": one["beta_s"],
            },
        }
        for one in materials
        if one["poisson"] != MATERIALS["tin"]["poisson"]  # between two stops
    ]
    given = {"data": data, "wanted": wanted, "scale": SCALE_M}
    found = run_script(body, given, "synth.js", "unpack.js")
    assert len(found) == 10
    for made, one in zip(found, wanted, strict=True):
        material = next(each for each in materials if each["poisson"] == one["poisson"])
        material = {
            **material,
            "young_pa": one["material"]["young"],
            "density_kg_m3": one["material"]["density"],
            "alpha_per_s": one["material"]["alpha"],
            "beta_s": one["material"]["beta"],
        }
        true = solve_material(basis, material, SCALE_M, MODES)
        np.testing.assert_allclose(np.array(made["omega"]) / 2 / np.pi, true.frequencies_hz, rtol=1e-9)
        np.testing.assert_allclose(made["damping"], true.damping_per_s, rtol=1e-9)


def test_a_strike_on_the_page_is_a_strike_on_the_body(basis, data):
    """The whole way in JavaScript: decode, gains at the point, shapes of the material's node, samples."""
    body = """
      const body = await unpack.body(given.data);
      const stop = body.poisson.indexOf(given.poisson);
      const node = synth.nearestStop(body.nodes, given.poisson);
      const modes = synth.inMaterial(unpack.angular(body, stop), given.material, given.scale);
      return given.strikes.map(({face, barycentric, normal}) => {
        const gains = unpack.gains(body, face, barycentric, normal);
        const weights = synth.struckWeights(gains, unpack.rotation(body, node), given.material.density, given.scale);
        return {weights, samples: synth.render({...modes, weights}).samples};
      });
    """
    material = MATERIALS["glass"]
    vertices, faces = unpacked(data["positions"]).T, unpacked(data["faces"]).astype(int)
    places = [contact(vertices, faces, point) for point in POINTS]
    given = {
        "data": data,
        "poisson": material["poisson"],
        "scale": SCALE_M,
        "material": {
            "young": material["young_pa"],
            "density": material["density_kg_m3"],
            "alpha": material["alpha_per_s"],
            "beta": material["beta_s"],
        },
        "strikes": [
            {
                "face": int(np.flatnonzero((faces == place.corners).all(axis=1))[0]),
                "barycentric": [*place.barycentric],
                "normal": [*place.normal],
            }
            for place in places
        ],
    }
    struck = run_script(body, given, "synth.js", "unpack.js")
    true = solve_material(basis, material, SCALE_M, MODES)
    shapes_ = mode_shapes(basis.surface, basis.correction_surface, true.coefficients)
    for point, made in zip(POINTS, struck, strict=True):
        place = contact(basis.vertices, basis.faces, point)
        weights = place.weights(shapes_[:, place.corners])
        assert np.abs(made["weights"] - weights).max() < 3e-3 * np.abs(weights).max()
        sound = impact_sound(true.frequencies_hz, true.damping_per_s, 44_100, weights=weights).samples
        length = min(len(sound), len(made["samples"])) - 500
        error = np.array(made["samples"][:length]) - sound[:length]
        assert 10 * np.log10((sound[:length] ** 2).sum() / (error**2).sum()) > 50


def test_the_error_is_measured(basis, data):
    assert data["measured"]["points"] == 24
    assert 0 < data["measured"]["named_rms_db"] < 0.2
    assert data["measured"]["named_rms_db"] <= data["measured"]["rms_db"] < 3
    # It is no constant: fewer steps of the columns make it larger.
    coarse = {**data, "columns": packed(*quantised(unpacked(data["columns"]), 7))}
    stops = build_stops(basis, [MATERIALS[name]["poisson"] for name in NAMED], 112, MODES)
    true = outside.outer(basis.vertices, basis.faces)
    worse = measured_error(basis, stops, [0.2], true, coarse, np.random.default_rng(3))
    assert worse["named_rms_db"] > 5 * data["measured"]["named_rms_db"]


def test_arrays_come_back():
    random = np.random.default_rng(0)
    fields = {
        "exact": packed(random.normal(size=(3, 5))),
        "coarse": packed(*quantised(random.normal(size=(4, 10)) * 1e-7, 1023)),
        "counts": packed(np.arange(70_000, 65_000, -9).astype(np.uint16)),
        "none": packed(np.zeros(0, np.float32)),
    }
    body = """
      const fields = {positions: given.exact, columns: given.exact, angular: given.exact, poisson: given.exact};
      const found = await unpack.body({...fields, ...given});
      return Object.keys(given).map((name) => found[name]);
    """
    for field, made in zip(fields.values(), run_script(body, fields, "unpack.js"), strict=True):
        assert made == unpacked(field).ravel().tolist()


def test_a_script_cannot_be_ended_early():
    text = call("vibraverse.body", "x", {"title": "</script>\u2028\u202e"})
    assert "</" not in text
    assert text.isascii()
    assert json.loads(re.search(r", (\{.*\})", text)[1])["title"] == "</script>\u2028\u202e"


def test_the_outside_lacks_the_cavity():
    vertices, faces = shapes.hollow_ball(0.9, 0.5)
    shown = outside.outer(vertices, faces)
    radii = np.linalg.norm(vertices[np.unique(shown)], axis=1)
    assert radii.min() > 0.8
    assert surfaces.volume(vertices, shown) == pytest.approx(4 / 3 * np.pi * 0.9**3, rel=0.02)


def test_decimation_keeps_vertices_and_shape():
    vertices, faces = shapes.ball(0.9, 4)
    few = outside.decimate(vertices, faces, 500)
    assert 400 <= len(np.unique(few)) <= 520
    assert surfaces.volume(vertices, few) == pytest.approx(surfaces.volume(vertices, faces), rel=0.02)
    assert (surfaces.edge_numbers(few)[1] == 2).all()
    assert outside.decimate(vertices, faces, len(vertices)) is faces


@pytest.fixture
def body(tmp_path, basis):
    """The files of the box, with a material that the basis did not serve."""
    with hdf5(tmp_path / "basis.h5") as file:
        write_basis(file, basis)
    with hdf5(tmp_path / "modes.h5") as file:
        write_provenance(file, {"stage": "modes", "options": {"corrected": True}})
        file.attrs.update({"size_m": 1.8 * SCALE_M, "scale_m": SCALE_M})
        for name, directly in (("steel", False), ("wood", True)):
            group = file.create_group(f"materials/{name}")
            group["frequencies_hz"] = solve_material(basis, MATERIALS[name], SCALE_M, MODES).frequencies_hz
            group.attrs.update({**MATERIALS[name], "solved_directly": directly})
    return tmp_path


def page_body(vibraverse, folder, name="page"):
    outputs = ("--script", folder / f"{name}.js", "--record", folder / f"{name}.json")
    inputs = ("--basis", folder / "basis.h5", "--modes", folder / "modes.h5")
    status, _, errors = vibraverse("page_body", "--object", "box", "--solidity", "solid", *inputs, *outputs)
    assert status == 0, errors
    return folder / f"{name}.js", folder / f"{name}.json"


def test_the_stage_writes_a_script_and_its_error(vibraverse, body):
    script, record = page_body(vibraverse, body)
    said = json.loads(record.read_text())
    assert said["provenance"]["output_sha256"]["script"] == sha256(script)
    assert said["bytes"] == script.stat().st_size < 600_000
    assert said["measured"]["named_rms_db"] < 0.2
    text = script.read_text(encoding="ascii")
    called = re.fullmatch(r'vibraverse\.body\("box", "solid", (\{.*\})\);\n', text)
    data = json.loads(called[1])
    assert data["scale_m"] == SCALE_M
    assert data["materials"]["wood"]["solved_directly"] is True
    assert data["materials"]["steel"]["young_pa"] == MATERIALS["steel"]["young_pa"]
    assert MATERIALS["steel"]["poisson"] in unpacked(data["nodes"])
    again, _ = page_body(vibraverse, body, "again")
    assert again.read_bytes() == script.read_bytes()


def test_a_refusal_is_passed_on(vibraverse, body):
    refusal = Refusal("box", "tets", "too_thin", "It is thin.", "", "solid")
    (body / "basis.h5").write_text(refusal.to_text())
    script, record = page_body(vibraverse, body)
    assert read_refusal(script).reason == read_refusal(record).reason == "too_thin"
