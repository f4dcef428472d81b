"""Frequencies, damping and shapes of materials, and the stages ``basis`` and ``modes``."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from meshes import box
from vibraverse.config.physics import MaterialModes, Sampled
from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.contract.seeds import rng
from vibraverse.files.modes import read_mode_shapes, read_surface
from vibraverse.files.tets import read_tets, write_tets
from vibraverse.flow.plan import Plan
from vibraverse.physics.basis import build_basis
from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.materials import MATERIALS, sampled
from vibraverse.physics.modes import departure, solve_material
from vibraverse.physics.shapes import mode_shapes


@pytest.fixture(scope="module")
def basis():
    return build_basis(*box((1.8, 1.2, 0.7), (4, 3, 2)), rng=rng("t"), modes=20)


def test_scaling_with_size_and_wave_speed_is_exact(basis):
    steel = MATERIALS["steel"]
    reference = solve_material(basis, steel, 0.1, 20)
    larger = solve_material(basis, steel, 0.25, 20)
    stiffer = solve_material(basis, {**steel, "young_pa": 4 * steel["young_pa"]}, 0.1, 20)
    denser = solve_material(basis, {**steel, "density_kg_m3": 9 * steel["density_kg_m3"]}, 0.1, 20)
    assert larger.frequencies_hz == pytest.approx(reference.frequencies_hz / 2.5, rel=1e-13)
    assert stiffer.frequencies_hz == pytest.approx(reference.frequencies_hz * 2, rel=1e-13)
    assert denser.frequencies_hz == pytest.approx(reference.frequencies_hz / 3, rel=1e-13)
    assert denser.mass_kg == pytest.approx(9 * 7850 * 1.8 * 1.2 * 0.7 * 0.1**3, rel=1e-12)


def test_mode_shapes_are_normalised_by_mass(basis):
    """A shape's kinetic energy needs the inside too, but how it scales is known from the surface."""
    glass = MATERIALS["glass"]
    small, large = (solve_material(basis, glass, scale, 5).coefficients for scale in (0.1, 0.2))
    assert large == pytest.approx(small / np.sqrt(8), rel=1e-12)


@pytest.mark.parametrize("corrected", [True, False])
def test_departure_tells_modes_from_others(basis, corrected):
    """Modes are orthonormal in the mass and have Rayleigh's quotient; a mixture, another length, another ν do not."""
    glass = MATERIALS["glass"]
    modes = solve_material(basis, glass, 0.1, 12, corrected)

    def wrong(change, material=glass):
        coefficients = modes.coefficients.astype(np.float32).astype(float)
        change(coefficients)
        return np.flatnonzero(
            departure(basis, material, 0.1, modes.frequencies_hz, coefficients) > 1e-5
        ).tolist()

    def mix(coefficients):
        coefficients[[2, 7]] = np.array([[0.8, 0.6], [-0.6, 0.8]]) @ coefficients[[2, 7]]

    def lengthen(coefficients):
        coefficients[4] *= 1.001

    assert wrong(lambda _: None) == []
    assert wrong(mix) == [2, 7]
    assert wrong(lengthen) == [4]
    assert wrong(lambda _: None, {**glass, "poisson": 0.21}) != []


def test_mode_shapes_combine_basis_and_corrections(basis):
    modes = solve_material(basis, MATERIALS["glass"], 0.1, 12)
    every = np.concatenate([basis.surface, basis.correction_surface], axis=2).astype(float)
    expected = np.einsum("mq,vdq->mvd", modes.coefficients, every)
    shapes = mode_shapes(basis.surface, basis.correction_surface, modes.coefficients)
    assert shapes == pytest.approx(expected, rel=1e-5, abs=1e-5 * float(np.abs(expected).max()))
    some = [7, 3]
    assert (
        mode_shapes(basis.surface[some], basis.correction_surface[some], modes.coefficients)
    ) == pytest.approx(shapes[:, some], rel=1e-5, abs=1e-5 * float(np.abs(expected).max()))


def test_rayleigh_damping():
    omega = 2 * np.pi * np.array([100.0, 1000.0, 10_000.0])
    damping, damped = rayleigh_damping(omega, 6.0, 1e-7)
    assert damping == pytest.approx(0.5 * (6.0 + 1e-7 * omega**2))
    assert damped == pytest.approx(omega * np.sqrt(1 - (damping / omega) ** 2))
    # Heavily damped: no ring, and no NaN.
    damping, damped = rayleigh_damping(omega, 1e6, 1.0)
    assert (damping > omega).all()
    assert (damped == 0).all()


@pytest.fixture
def chain(tmp_path, vibraverse):
    """Run basis and modes on a small brick; returns the folder."""
    write_tets(tmp_path / "tets.msh", *box((1.8, 1.2, 0.7), (3, 2, 2)))
    (tmp_path / "clean.json").write_text('{"size_m": 0.09}')

    def run(materials, size_m=None, corrected=True, **more):
        body = ("--object", "brick", "--solidity", "solid")
        status, _, err = vibraverse(
            "basis", *body, "--tets", tmp_path / "tets.msh", "--basis", tmp_path / "basis.h5",
            "--options", json.dumps({"modes": 12}),
        )  # fmt: skip
        assert status == 0, err
        status, _, err = vibraverse(
            "modes", *body, "--basis", tmp_path / "basis.h5", "--tets", tmp_path / "tets.msh",
            "--clean-record", tmp_path / "clean.json", "--modes", tmp_path / "modes.h5", "--options",
            json.dumps({"materials": materials, "modes": 12, "size_m": size_m, "corrected": corrected, **more}),
        )  # fmt: skip
        return status, err

    run.folder = tmp_path
    return run


def test_modes_file(chain):
    import h5py

    status, err = chain({name: MATERIALS[name] for name in ("steel", "wood")})
    assert status == 0
    assert err.startswith("vibraverse modes --object brick --solidity solid --basis ")
    with h5py.File(chain.folder / "modes.h5") as h5:
        assert h5.attrs["size_m"] == 0.09
        assert list(h5["materials"]) == ["steel", "wood"]
        steel = h5["materials/steel"]
        assert steel["frequencies_hz"].shape == (12,)
        assert steel["frequencies_hz"].attrs["unit"] == "Hz"
        assert (np.diff(steel["frequencies_hz"]) >= 0).all()
        assert "mode_shapes" not in steel
        with h5py.File(chain.folder / "basis.h5") as basis:
            shapes = read_mode_shapes(h5, read_surface(basis), "steel")
            assert shapes.shape == (12, len(basis["surface/vertices"]), 3)
            some = read_mode_shapes(h5, read_surface(basis, [5, 2]), "steel", [5, 2])
        assert some == pytest.approx(shapes[:, [5, 2]], rel=1e-5, abs=1e-6 * float(np.abs(shapes).max()))
        assert steel.attrs["mass_kg"] == pytest.approx(7850 * 1.8 * 1.2 * 0.7 * 0.05**3)
        provenance = json.loads(h5.attrs["provenance"])
    assert provenance["stage"] == "modes"
    assert set(provenance["input_sha256"]) == {"basis", "tets", "clean_record"}
    assert provenance["options"]["materials"]["wood"]["young_pa"] == 1.1e10


def test_a_material_out_of_range_is_solved_on_the_mesh(chain):
    """Rubber's Poisson's ratio lies far outside the basis: its frequencies are as right as those of any other."""
    import h5py

    rubber = {**MATERIALS["plastic"], "poisson": 0.49}
    assert chain({"steel": MATERIALS["steel"], "rubber": rubber})[0] == 0
    right = build_basis(
        *read_tets(chain.folder / "tets.msh"),
        rng=rng("r"),
        modes=12,
        poisson_range=(0.48, 0.49),
        max_error=1e-6,
    )
    with h5py.File(chain.folder / "modes.h5") as h5:
        flags = {name: bool(group.attrs["solved_directly"]) for name, group in h5["materials"].items()}
        found = h5["materials/rubber"]
        assert flags == {"rubber": True, "steel": False}
        assert found["relative_error"][()].max() < 1e-4
        expected = solve_material(right, rubber, h5.attrs["scale_m"], 12, corrected=False).frequencies_hz
        # The corrections belong to other ν there, so only what the mesh itself says can be compared closely.
        assert (found["frequencies_hz"][()] < expected).all()
        # Shapes of the same rod, whether they are coefficients or as they are: the lowest mode differs little with ν.
        assert "mode_coefficients" not in found
        with h5py.File(chain.folder / "basis.h5") as basis:
            lowest = [
                read_mode_shapes(h5, read_surface(basis), name)[0].ravel() for name in ("steel", "rubber")
            ]
        lengths = [np.linalg.norm(shape) for shape in lowest]
        assert abs(lowest[0] @ lowest[1]) > 0.98 * lengths[0] * lengths[1]
        assert lengths[1] / lengths[0] == pytest.approx(np.sqrt(7850 / 1070), rel=0.05)
        assert found["frequencies_hz"][()] == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, "light"),
        ({"basis": {"max_error": 1e-4}}, "light"),
        ({"basis": {"max_error": 2e-4}}, "solver"),
        ({"modes": {"tolerance": 1e-6}}, "solver"),
        ({"basis": {"poisson_range": [0.2, 0.4]}}, "solver"),  # ceramic has 0.19
    ],
)
def test_memory_suffices_for_a_solve_on_the_mesh(values, expected):
    sources = {"generated": {"count": 1}, "bundled": []}
    assert Plan({"sources": sources, **values}).modes_class() == expected


def test_sampled_materials_stay_when_more_are_drawn():
    ranges = Sampled().ranges()
    few, many = (sampled("cup-0000", 0, count, ranges) for count in (5, 4000))
    for name, (low, high) in ranges.items():
        np.testing.assert_array_equal(many[name][:5], few[name])
        assert low <= many[name].min() < many[name].max() <= high
        scale = (lambda x: x) if name == "poisson" else np.log
        # Even between the ends: the mean of 4,000 lies within four standard errors of the middle.
        place = (scale(many[name]) - scale(low)) / (scale(high) - scale(low))
        assert abs(place.mean() - 0.5) < 4 / np.sqrt(12 * 4000)
    parameters = np.stack(list(many.values()))
    assert np.abs(np.corrcoef(parameters) - np.eye(5)).max() < 0.1
    assert (sampled("cup-0001", 0, 5, ranges)["young_pa"] != few["young_pa"]).all()
    assert (sampled("cup-0000", 1, 5, ranges)["young_pa"] != few["young_pa"]).all()
    # Fixed for ever, on every machine.
    assert few["young_pa"][0] == pytest.approx(PINNED_YOUNG_PA, rel=1e-12)


PINNED_YOUNG_PA = 4236078362.579333


def test_sampled_materials_of_a_body(chain, vibraverse):
    """Each equals a named material with the same numbers; sounds on request."""
    import h5py
    import soundfile

    assert chain({"tin": MATERIALS["tin"]}, sampled={"count": 4})[0] == 0
    with h5py.File(chain.folder / "modes.h5") as h5:
        found = {key: (array[()], array.attrs["unit"]) for key, array in h5["sampled"].items()}
        assert {unit for _, unit in found.values()} == {"1", "Hz", "Pa", "kg", "kg/m³", "1/s", "s"}
    own = {key: float(found[key][0][2]) for key in MATERIALS["tin"]}
    sounds = chain.folder / "sounds"
    assert chain({"own": own}, sampled={"count": 3})[0] == 0
    with h5py.File(chain.folder / "modes.h5") as h5:
        named = h5["materials/own"]
        assert found["frequencies_hz"][0].shape == (4, 12)
        np.testing.assert_array_equal(found["frequencies_hz"][0][2], named["frequencies_hz"])
        np.testing.assert_array_equal(found["frequencies_hz"][0][:3], h5["sampled/frequencies_hz"])
        assert found["mass_kg"][0][2] == named.attrs["mass_kg"]
        assert found["relative_error"][0][2] == pytest.approx(named["relative_error"][()], rel=1e-6)
    status, _, err = vibraverse(
        "audio", "--object", "brick", "--solidity", "solid", "--basis", chain.folder / "basis.h5",
        "--modes", chain.folder / "modes.h5",
        "--sounds", sounds, "--options", json.dumps({"points": [[0, 0, 0.9]], "sampled": 3}),
    )  # fmt: skip
    assert status == 0, err
    of_sampled, named = (soundfile.read(sounds / name)[0] for name in ("sampled-0002.wav", "own.wav"))
    assert of_sampled == pytest.approx(named, abs=2e-7)
    assert sorted(path.stem for path in sounds.glob("*.wav")) == [  # struck points need mode shapes
        "own", "own-p0", "sampled-0000", "sampled-0001", "sampled-0002",
    ]  # fmt: skip


def test_uncorrected_frequencies_are_those_of_the_mesh(chain):
    import h5py

    found = {}
    for corrected in (True, False):
        assert chain({"tin": MATERIALS["tin"]}, corrected=corrected)[0] == 0
        with h5py.File(chain.folder / "modes.h5") as h5:
            found[corrected] = [
                h5[f"materials/tin/{name}"][()] for name in ("frequencies_hz", "discretisation_error")
            ]
    (fine, left), (mesh, error) = found[True], found[False]
    assert (fine < mesh).all()
    # On one mesh the two agree about how far apart they are (single modes change places), and less is left.
    assert (mesh / fine - 1).mean() == pytest.approx(error.mean(), rel=0.1)
    assert left.max() < 0.5 * error.max()


def test_products_repeat_to_the_byte(chain):
    chain({"tin": MATERIALS["tin"]})
    first = [(chain.folder / name).read_bytes() for name in ("basis.h5", "modes.h5")]
    chain({"tin": MATERIALS["tin"]})
    assert [(chain.folder / name).read_bytes() for name in ("basis.h5", "modes.h5")] == first


def test_configured_size_wins(chain):
    import h5py

    chain({"tin": MATERIALS["tin"]}, size_m=0.5)
    with h5py.File(chain.folder / "modes.h5") as h5:
        assert (h5.attrs["size_m"], h5.attrs["size_origin"]) == (0.5, "configuration")


@pytest.mark.parametrize(
    ("options", "record", "expected"),
    [
        (
            {"size_m": 0.5, "size_origin": "manifest"},
            {"size_m": 0.1, "size_origin": "file"},
            (0.5, "manifest"),
        ),
        ({"size_m": 0.5}, {"size_m": 0.1}, (0.5, "configuration")),
        ({}, {"size_m": 0.1, "size_origin": "file"}, (0.1, "file")),
        ({"default_size_m": 0.2}, {"size_m": None, "size_origin": None}, (0.2, "default")),
    ],
)
def test_every_size_says_who_stated_it(options, record, expected):
    materials = {"tin": MATERIALS["tin"]}
    assert MaterialModes(materials=materials, **options).object_size(record) == expected


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"poisson": 0.5}, "modes.materials.tin.poisson must be less than 0.5, not 0.5"),
        ({"density_kg_m3": -1}, "modes.materials.tin.density_kg_m3 must be greater than 0, not -1"),
        ({"young": 1}, "unknown key 'modes.materials.tin.young'; did you mean 'young_pa'"),
    ],
)
def test_bad_material_is_one_sentence(chain, change, sentence):
    status, err = chain({"tin": {**MATERIALS["tin"], **change}})
    assert status == 2
    assert sentence in err
    assert len(err.strip().splitlines()) == 1
    assert not (chain.folder / "modes.h5").exists()


def test_refused_tetrahedra_are_passed_on(tmp_path, vibraverse):
    refusal = Refusal("brick", "clean", "not_a_solid", "It is flat.", "Thicken it.")
    (tmp_path / "tets.msh").write_text(refusal.to_text())
    status, _, _ = vibraverse(
        "basis", "--object", "brick", "--solidity", "solid",
        "--tets", tmp_path / "tets.msh", "--basis", tmp_path / "basis.h5",
    )  # fmt: skip
    assert status == 0
    assert read_refusal(tmp_path / "basis.h5") == refusal


def test_broken_tetrahedra_become_a_refusal(tmp_path, vibraverse):
    points, cells = box((1, 1, 1), (2, 2, 2))
    points[:, 0] = 0.0
    write_tets(tmp_path / "tets.msh", points, cells)
    status, _, err = vibraverse(
        "basis", "--object", "flat", "--solidity", "hollow",
        "--tets", tmp_path / "tets.msh", "--basis", tmp_path / "basis.h5",
    )  # fmt: skip
    assert status == 0
    assert "zero or negative volume" in err
    refusal = read_refusal(tmp_path / "basis.h5")
    assert (refusal.object, refusal.solidity, refusal.stage, refusal.reason) == (
        "flat",
        "hollow",
        "basis",
        "solve_failed",
    )


@pytest.mark.parametrize(
    ("factorisation", "memory_mb"),
    [("pardiso", 60), ("pardiso", 150), ("pardiso", 400), ("superlu", 400)],
)
def test_a_body_too_large_for_its_memory_is_refused(tmp_path, factorisation, memory_mb):
    """In a process of its own, because the limit counts everything that the process has.

    Early and late: where memory runs out while they load, MKL ends the process and OpenBLAS tries again for ever.
    """
    write_tets(tmp_path / "tets.msh", *box((1.8, 1.2, 0.9), (9, 7, 6)))
    options = {"factorisation": factorisation, "memory_mb": memory_mb}
    done = subprocess.run(
        [sys.executable, "-m", "vibraverse", "basis", "--object", "brick", "--solidity", "solid",
         "--tets", tmp_path / "tets.msh", "--basis", tmp_path / "basis.h5", "--options", json.dumps(options)],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    refusal = read_refusal(tmp_path / "basis.h5")
    assert refusal.reason == "limit"
    assert f"{memory_mb} MB" in refusal.message
    assert "basis.memory_mb" in refusal.advice


def test_a_cut_through_a_multiplet_is_said():
    """A cube's elastic modes come as 2, 3, 3, 3, ...: the fifth is one of three, the eighth the last of three."""
    cube = build_basis(*box((1, 1, 1), (3, 3, 3)), rng=rng("c"), modes=12)
    cut, whole = (solve_material(cube, MATERIALS["steel"], 0.1, modes, False) for modes in (4, 8))
    assert cut.following_hz == pytest.approx(cut.frequencies_hz[-1], rel=1e-2)
    assert whole.following_hz > 1.05 * whole.frequencies_hz[-1]


def test_tetrahedra_file_round_trip(tmp_path):
    points, cells = box((1, 2, 3), (2, 1, 1))
    write_tets(tmp_path / "a.msh", points, cells)
    again = read_tets(tmp_path / "a.msh")
    assert np.array_equal(again[0], points)
    assert np.array_equal(again[1], cells)
