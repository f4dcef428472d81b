"""Fresh materials: labels equal those of the stage ``modes``, in any process."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

import make_products
import vibraverse.dataset
from vibraverse.files.basis import read_basis
from vibraverse.flow.paths import Paths
from vibraverse.physics.materials import MATERIALS

FIELDS = ["frequencies_hz", "damping_per_s", "young_pa", "density_kg_m3", "poisson", "size_m", "mass_kg"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A dataset whose bar has real modes: basis and modes come from the stages."""
    results = tmp_path_factory.mktemp("fresh") / "results"
    make_products.make(results)
    real_modes(Paths(results), "bar-0000", "hollow")
    make_products.index(results, make_products.pack(results))
    return results / "dataset"


def real_modes(paths: Paths, object_id: str, solidity: str) -> None:
    """Replace the drawn basis and modes of a body by computed ones."""
    at = {
        name: paths.at(getattr(paths, name), object=object_id, solidity=solidity)
        for name in ("tets", "basis", "modes", "clean_record")
    }
    body = ("--object", object_id, "--solidity", solidity)
    make_products.call(
        "basis", *body, "--tets", at["tets"], "--basis", at["basis"], "--options", '{"modes": 64}'
    )
    options = {
        "materials": {name: MATERIALS[name] for name in make_products.MATERIAL_NAMES},
        "size_m": make_products.SIZE_M,
        "sampled": {"count": 2},
    }
    make_products.call(
        "modes", *body, "--basis", at["basis"], "--tets", at["tets"], "--clean-record", at["clean_record"],
        "--modes", at["modes"], "--options", json.dumps(options),
    )  # fmt: skip


def only(**values) -> dict:
    """Return ranges that allow a single value each."""
    return {name: (value, value) for name, value in values.items()}


def test_labels_are_those_of_the_stage(folder):
    settings = {"ranges": only(**MATERIALS["glass"]), "size_m": (make_products.SIZE_M,) * 2}
    fields = [
        *FIELDS,
        "damped_frequencies_hz",
        "relative_error",
        "discretisation_error",
        "volume_m3",
        "scale_m",
    ]
    fresh = vibraverse.dataset.fresh_materials(
        folder, fields, settings=settings, object="bar-0000", solidity="hollow"
    )
    assert len(fresh) == 1
    item = fresh[0]
    with vibraverse.dataset.open(folder) as reader:
        for name in fields:
            stored = reader.read(name, "bar-0000", "hollow", "glass")
            assert item[name] == pytest.approx(stored, rel=1e-12), name
            assert item[name].dtype == stored.dtype
    assert (item["object"], item["solidity"], item["material"]) == ("bar-0000", "hollow", "fresh")


def test_another_material_and_size_every_epoch(folder):
    fresh = vibraverse.dataset.fresh_materials(folder, [*FIELDS, "occupancy"], settings={"seed": 3})
    assert [(one["object"], one["solidity"]) for one in fresh.items] == [
        ("ball-0000", "solid"), ("bar-0000", "solid"), ("bar-0000", "hollow"),
    ]  # fmt: skip
    first = fresh[2]
    seen = []
    for epoch in range(200):
        fresh.epoch = epoch
        seen.append(fresh[2])
    values = {name: np.array([item[name] for item in seen]) for name in ("young_pa", "poisson", "size_m")}
    for name, (low, high) in {"young_pa": (5e8, 5e11), "poisson": (0.1, 0.4), "size_m": (0.05, 0.5)}.items():
        assert len(set(values[name])) == 200
        assert low <= values[name].min() < values[name].max() <= high
        scale = (lambda x: x) if name == "poisson" else np.log
        place = (scale(values[name]) - scale(low)) / (scale(high) - scale(low))
        assert place.mean() == pytest.approx(0.5, abs=4 / np.sqrt(12 * 200))
    assert first["occupancy"].shape == (16, 16, 16)
    # f ∝ sqrt(E/ρ) / L at one ν, whatever was drawn.
    fixed = vibraverse.dataset.fresh_materials(
        folder, FIELDS, settings={"ranges": only(poisson=0.3)}, object="bar-0000"
    )
    invariant = []
    for epoch in range(3):
        fixed.epoch = epoch
        item = fixed[1]
        speed = np.sqrt(item["young_pa"] / item["density_kg_m3"])
        invariant.append(item["frequencies_hz"] * item["size_m"] / speed)
    assert invariant[1] == pytest.approx(invariant[0], rel=1e-9)
    assert invariant[2] == pytest.approx(invariant[0], rel=1e-9)


def test_an_item_depends_on_seed_epoch_and_body_alone(folder):
    def item(seed=0, epoch=0, copy=False, **conditions):
        fresh = vibraverse.dataset.fresh_materials(
            folder, FIELDS, settings={"seed": seed, "bases": 1}, **conditions
        )
        fresh.epoch = epoch
        fresh[0]
        fresh = pickle.loads(pickle.dumps(fresh)) if copy else fresh
        return fresh[len(fresh) - 1]

    same = item()
    for other in (item(copy=True), item(object="bar-0000"), item(solidity="hollow")):
        np.testing.assert_array_equal(other["frequencies_hz"], same["frequencies_hz"])
    for other in (item(seed=1), item(epoch=1)):
        assert other["young_pa"] != same["young_pa"]


def test_mode_shapes_are_those_of_the_material_and_size_drawn(folder):
    fields = (*FIELDS, "mode_coefficients", "mode_shapes")
    item = vibraverse.dataset.fresh_materials(folder, fields)[1]
    with vibraverse.dataset.open(folder) as reader:
        place = item["object"], item["solidity"]
        stored = reader.read("mode_shapes", *place, "steel")
        surface, corrections = reader.surface(*place)
        scale_m = float(reader.read("scale_m", *place))
        density = float(reader.read("density_kg_m3", *place, "steel"))
    every = np.concatenate([surface, corrections], axis=2)[:, :, : item["mode_coefficients"].shape[1]]
    expected = np.einsum("mq,vdq->mvd", item["mode_coefficients"], every)
    assert item["mode_shapes"] == pytest.approx(expected, rel=1e-4, abs=1e-5 * float(np.abs(expected).max()))
    # All modes of these products keep their shape in every material, so only the mass makes a difference.
    mass = (item["density_kg_m3"] * (item["size_m"] / 1.8) ** 3) / (density * scale_m**3)
    assert np.abs(item["mode_shapes"]) == pytest.approx(
        np.abs(stored) / np.sqrt(mass), rel=1e-3, abs=1e-3 * float(np.abs(stored).max() / np.sqrt(mass))
    )


def test_what_cannot_be_drawn_is_said(folder):
    with pytest.raises(KeyError, match="a fresh material has no sound"):
        vibraverse.dataset.fresh_materials(folder, ["sound"])
    fresh = vibraverse.dataset.fresh_materials(folder, FIELDS, settings={"ranges": {"poisson": (0.1, 0.45)}})
    with pytest.raises(ValueError, match=r"holds for Poisson's ratios 0\.1 to 0\.4, not 0\.1 to 0\.45"):
        fresh[0]


def test_without_a_surface_the_basis_is_small(folder):
    with vibraverse.dataset.open(folder) as reader:
        basis = read_basis(reader.group("bar-0000")["hollow/basis"], surface=False)
    assert basis.surface is None
    assert basis.a_mu.shape == basis.a_lambda.shape
