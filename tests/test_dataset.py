"""The dataset: what is packed is what the stages made, it follows the schema, and it reads back."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import soundfile

import make_products
import vibraverse.dataset
from vibraverse.contract import products
from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import read_refusal
from vibraverse.dataset import schema
from vibraverse.dataset.check import validator
from vibraverse.physics.materials import MATERIALS


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset") / "results"
    make_products.build(folder)
    return folder


@pytest.fixture
def reader(results):
    with vibraverse.dataset.open(results / "dataset") as opened:
        yield opened


def problems(shard) -> list:
    with h5py.File(shard) as h5:
        return validator.problems(h5)


def test_shards_follow_the_schema(reader):
    assert len(reader.shards) == 2
    assert [problems(shard) for shard in reader.shards.values()] == [[], []]


def test_the_validator_notices_what_is_wrong(results, tmp_path):
    broken = tmp_path / "broken.h5"
    broken.write_bytes((results / "dataset/shards/1.h5").read_bytes())
    with h5py.File(broken, "r+") as h5:
        group = h5["objects/bar-0000"]
        del group["solid/materials/steel/frequencies_hz"].attrs["unit"]
        group["extra"] = [1.0]
        del group["grids/occupancy"]
        group["grids/occupancy"] = np.zeros((4, 4), np.float64)
        group["solid"].attrs["colour"] = "red"
    with h5py.File(broken) as h5:
        found = "\n".join(f"{name}: {sentence}" for name, sentence in validator.problems(h5))
    assert "bar-0000: solid/materials/steel/frequencies_hz has the unit None, not 'Hz'" in found
    assert "bar-0000: the dataset has no field at 'extra'" in found
    assert "grids/occupancy has shape (4, 4), not (n, n, n)" in found
    assert "grids/occupancy is float64, not uint8" in found
    assert "no field at 'solid@colour'" in found
    with h5py.File(tmp_path / "other.h5", "w") as h5:
        assert validator.problems(h5) == [
            ("", "this is not a shard: its attribute 'format' is not 'vibraverse-shard'")
        ]


def test_every_numeric_dataset_has_a_unit_and_every_field_a_place(reader):
    seen = set()

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            field = schema.field_at(name)
            seen.add(field.name)
            assert field.is_text or item.attrs["unit"], name
        seen.update(schema.field_at(f"{name}@{key}").name for key in item.attrs if key != "unit")

    for object_id in make_products.OBJECTS:
        group = reader.group(object_id)
        visit("", group)
        group.visititems(visit)
    assert seen == set(schema.BY_NAME) - {"mode_shapes"}  # made from their coefficients


def test_arrays_are_the_products_to_the_last_bit(reader, results):
    folder = results / "objects/bar-0000"
    with h5py.File(folder / "hollow/modes.h5") as modes:
        for name in ("frequencies_hz", "damping_per_s", "damped_frequencies_hz", "mode_coefficients"):
            expected = modes[f"materials/steel/{name}"][()]
            np.testing.assert_array_equal(reader.read(name, "bar-0000", "hollow", "steel"), expected)
        scale = modes["materials/steel/mode_coefficients"][0, 0]
    with h5py.File(folder / "hollow/basis.h5") as basis:
        shapes = basis["surface/basis"][()].transpose(2, 0, 1) * scale  # every mode is one field of the basis
        np.testing.assert_array_equal(reader.read("mode_shapes", "bar-0000", "hollow", "steel"), shapes)
        np.testing.assert_array_equal(
            reader.read("vertices", "bar-0000", "hollow"), basis["surface/vertices"][()]
        )
        np.testing.assert_array_equal(
            reader.read("reduced_mu", "bar-0000", "hollow"), basis["reduced/mu"][()]
        )
        np.testing.assert_array_equal(
            reader.read("surface_basis", "bar-0000", "hollow"), basis["surface/basis"][()]
        )
    with h5py.File(folder / "grids.h5") as grids:
        np.testing.assert_array_equal(
            reader.read("signed_distance", "bar-0000"), grids["signed_distance"][()]
        )
    assert reader.read("boundary_faces", "bar-0000").shape == (
        2 * len(reader.read("surface_faces", "bar-0000")),
        3,
    )
    assert reader.read("clean", "bar-0000") == products.read_json(folder / "clean.json")


def test_sounds_keep_all_24_bits(reader, results):
    samples = reader.read("sound", "bar-0000", "solid", "glass")
    stored, sample_rate_hz = soundfile.read(
        results / "objects/bar-0000/solid/sounds/glass.wav", dtype="int32", always_2d=False
    )
    assert samples.dtype == np.float32
    np.testing.assert_array_equal(np.round(samples.astype(np.float64) * 2**31).astype(np.int64), stored)
    assert reader.read("sample_rate_hz", "bar-0000", "solid", "glass") == sample_rate_hz == 44_100
    assert reader.read("duration_s", "bar-0000", "solid", "glass") == len(stored) / 44_100
    assert np.abs(samples).max() == pytest.approx(10 ** (-1 / 20), abs=1e-6)


def test_pictures_keep_their_bytes_and_come_decoded(reader, results):
    stored = reader.group("bar-0000")["views/wood"][1].tobytes()
    assert stored == (results / "objects/bar-0000/views/wood-01.png").read_bytes()
    clay, wood = reader.read("views", "bar-0000"), reader.read("views", "bar-0000", look="wood")
    assert clay.shape == wood.shape == (3, 96, 96, 3)
    assert clay.dtype == np.uint8
    # Wood is browner than clay: its blue is weaker against its red.
    assert wood[..., 2].mean() / wood[..., 0].mean() < clay[..., 2].mean() / clay[..., 0].mean()


def test_volume_and_mass_follow_from_the_tetrahedra(reader):
    size = make_products.SIZE_M
    box = 1.0 * (0.4 / 1.8) * (0.3 / 1.8) * size**3
    assert reader.read("volume_m3", "bar-0000", "solid") == pytest.approx(box, rel=1e-12)
    mass = reader.read("mass_kg", "bar-0000", "solid", "steel")
    assert mass == pytest.approx(7850 * box, rel=1e-12)


def test_items_are_one_per_object_body_and_material(reader):
    assert len(reader) == 4 + 8
    assert reader.objects == ["ball-0000", "bar-0000"]
    item = reader.items[0]
    assert (item["object"], item["solidity"], item["material"]) == ("ball-0000", "solid", "ceramic")
    expected = make_products.frequencies("ball-0000", "solid", MATERIALS["ceramic"])
    assert item["f1_hz"] == expected[0]
    sample = reader[0]
    np.testing.assert_array_equal(sample["frequencies_hz"], expected)
    assert sample["young_pa"] == 7.2e10
    assert len(list(reader)) == len(reader)


def test_sampled_materials_are_read_like_any_other(reader, results):
    assert {item["sampled"] for item in reader.items} == {3}
    every = reader.where(solidity="solid").with_sampled()
    assert len(every) == 2 * (4 + 3)
    assert [item["material"] for item in every.items[4:7]] == ["sampled-0000", "sampled-0001", "sampled-0002"]
    sample, item = every[5], every.items[5]
    with h5py.File(results / "objects/ball-0000/solid/modes.h5") as modes:
        stored = {key: array[1] for key, array in modes["sampled"].items()}
    for key in ("frequencies_hz", "young_pa", "density_kg_m3", "poisson"):
        np.testing.assert_array_equal(sample[key], stored[key])
    omega = 2 * np.pi * stored["frequencies_hz"]
    expected = 0.5 * (stored["alpha_per_s"] + stored["beta_s"] * omega**2)
    assert sample["damping_per_s"] == pytest.approx(expected, rel=1e-12)
    damped = reader.read("damped_frequencies_hz", "ball-0000", "solid", "sampled-0001")
    assert damped == pytest.approx(np.sqrt(np.maximum(omega**2 - expected**2, 0)) / (2 * np.pi), rel=1e-12)
    assert (item["f1_hz"], item["mass_kg"]) == (stored["frequencies_hz"][0], stored["mass_kg"])
    assert (item["duration_s"], item["split"]) == (0.0, every.items[0]["split"])
    for material, field in (("sampled-0003", "frequencies_hz"), ("sampled-0001", "mode_shapes")):
        with pytest.raises(KeyError, match=f"holds no {field}"):
            reader.read(field, "ball-0000", "solid", material)


def test_narrowing(reader):
    hollow = reader.where(solidity="hollow", material=["wood", "steel"])
    assert [(item["object"], item["material"]) for item in hollow.items] == [
        ("bar-0000", "wood"),
        ("bar-0000", "steel"),
    ]
    assert len(reader.where(split="train")) + len(reader.where(split=["validation", "test"])) == len(reader)
    with pytest.raises(KeyError, match="unknown column 'materials'; did you mean 'material'"):
        reader.where(materials="steel")


def test_chosen_fields(results):
    path = results / "dataset/shards/1.h5"
    with vibraverse.dataset.open(path, fields=["views", "occupancy"], look="material") as reader:
        sample = reader.where(material="wood")[0]
        assert set(sample) == {"object", "solidity", "material", "views", "occupancy"}
        np.testing.assert_array_equal(sample["views"], reader.read("views", "bar-0000", look="wood"))


def test_wrong_names_are_said_with_the_nearest_right_one(reader, results):
    with pytest.raises(KeyError, match="unknown field 'frequency_hz'; did you mean 'frequencies_hz'"):
        reader.read("frequency_hz", "bar-0000")
    with pytest.raises(KeyError, match="unknown field"):
        vibraverse.dataset.open(results / "dataset", fields=["nonsense"])
    with pytest.raises(KeyError, match="unknown object 'bar-0001'; did you mean 'bar-0000'"):
        reader.read("occupancy", "bar-0001")
    with pytest.raises(KeyError, match=r"unknown material 'tin' \(known: ceramic, glass, steel, wood"):
        reader.read("frequencies_hz", "ball-0000", "solid", "tin")
    with pytest.raises(FileNotFoundError, match="holds no finished dataset"):
        vibraverse.dataset.open(results)


def test_refusals_stay_with_their_objects(reader):
    leaf, ball = reader.group("leaf"), reader.group("ball-0000")
    assert leaf.attrs["refusal_reason"] == "not_a_solid"
    assert leaf.attrs["refusal_stage"] == "clean"
    assert "surface" not in leaf
    assert ball["hollow"].attrs["refusal_reason"] == "too_thin"
    assert ball["hollow"].attrs["refusal_message"] == "The wall of ball-0000 would be too thin."
    assert "materials" not in ball["hollow"]
    assert "refusal_reason" not in ball.attrs
    assert [(row["object"], row["solidity"]) for row in reader.refusals] == [
        ("ball-0000", "hollow"),
        ("leaf", ""),
    ]


def test_same_products_same_bytes_wherever_they_lie(results, tmp_path):
    # Another folder, another time, another order of the objects' making: the same shard.
    make_products.make(tmp_path / "elsewhere", objects=tuple(reversed(make_products.OBJECTS)))
    again = make_products.pack(tmp_path / "elsewhere")
    for shard in again:
        assert products.sha256(shard) == products.sha256(results / "dataset/shards" / shard.name)


def test_provenance_names_what_the_shard_came_from(reader, results):
    checksums = reader.read("products", "bar-0000")
    assert checksums["hollow/modes.h5"] == products.sha256(results / "objects/bar-0000/hollow/modes.h5")
    assert set(checksums) >= {
        "source.json",
        "clean.json",
        "grids.h5",
        "views/images.json",
        "hollow/hollow.json",
    }
    with h5py.File(results / "dataset/shards/1.h5") as h5:
        text = h5.attrs["provenance"]
    stated = json.loads(text)
    assert stated["stage"] == "dataset"
    assert stated["options"]["materials"] == list(make_products.MATERIAL_NAMES)
    assert str(results) not in text


@pytest.mark.parametrize("missing", ["solid/modes.h5", "solid/sounds/steel.wav", "views/clay-01.png"])
def test_a_missing_product_is_one_sentence(tmp_path, vibraverse, missing):
    paths = make_products.make(tmp_path, objects=("bar-0000",))
    (tmp_path / "objects/bar-0000" / missing).unlink()
    shard = tmp_path / "0.h5"
    status, _, errors = vibraverse(
        "dataset", "--shard", shard, "--options", make_products.options(paths.results, ["bar-0000"])
    )
    assert status == 2
    assert f"bar-0000/{missing} does not exist; run `vibraverse repair --results" in errors.splitlines()[-1]
    assert "Traceback" not in errors
    assert not shard.exists()


def test_an_empty_shard_is_a_shard(tmp_path):
    (shard,) = make_products.pack(tmp_path, groups=((),))
    with vibraverse.dataset.open(shard) as reader:
        assert len(reader) == 0
        assert problems(shard) == []


def test_few_shards_are_kept_open(results, monkeypatch):
    def files() -> int:
        return sum(Path(link).resolve().suffix == ".h5" for link in Path("/proc/self/fd").iterdir())

    monkeypatch.setattr("vibraverse.dataset.read.reader.MAX_OPEN_SHARDS", 1)
    before = files()
    with vibraverse.dataset.open(results / "dataset") as reader:
        assert files() == before
        group = reader.group("bar-0000")
        for name in ("ball-0000", "bar-0000", "ball-0000"):
            reader.read("frequencies_hz", name, "solid", "wood")
        assert group["grids/occupancy"].shape == (16, 16, 16)  # what is in use stays open
        del group
        assert files() == before + 1
    assert files() == before


def test_handles_are_each_process_s_own(reader):
    expected = reader.read("frequencies_hz", "bar-0000", "solid", "wood")
    copy = pickle.loads(pickle.dumps(reader))
    np.testing.assert_array_equal(copy.read("frequencies_hz", "bar-0000", "solid", "wood"), expected)
    copy.close()
    child = os.fork()
    if child == 0:  # in a forked worker: a handle of its own, and the right numbers
        inherited = dict(reader._handles)
        same = np.array_equal(reader.read("frequencies_hz", "bar-0000", "solid", "wood"), expected)
        os._exit(
            0 if same and not set(map(id, reader._handles.values())) & set(map(id, inherited.values())) else 1
        )
    assert os.waitpid(child, 0)[1] == 0
    reader.close()
    np.testing.assert_array_equal(reader.read("frequencies_hz", "bar-0000", "solid", "wood"), expected)


@pytest.mark.parametrize(
    ("field", "names", "sentence"),
    [
        ("mode_shapes", {}, "unknown material '' (known: "),
        (
            "frequencies_hz",
            {"material": "brass"},
            "unknown material 'brass'; did you mean 'glass'? (known: ceramic, ",
        ),
        (
            "sound",
            {"material": "steel", "sound": "steel-p7"},
            "unknown sound 'steel-p7'; did you mean 'steel'?",
        ),
        ("views", {"look": "gold"}, "unknown look 'gold'; did you mean 'wood'? (known: ceramic, "),
        ("boundary_faces", {"object": "bar-0000"}, ""),
    ],
)
def test_names_that_an_object_does_not_have_are_listed(reader, field, names, sentence):
    place = {"object": "bar-0000", **names}
    if not sentence:
        assert len(reader.read(field, **place))
        return
    with pytest.raises(KeyError) as caught:
        reader.read(field, **place)
    assert str(caught.value.args[0]).startswith(sentence)


def test_reading_needs_only_numpy_and_h5py(results):
    code = (
        "import sys; before = set(sys.modules); import numpy, h5py; needed = set(sys.modules) - before;"
        "import vibraverse.dataset as d; r = d.open(sys.argv[1]); r[0]; r.where(split='train');"
        "r.read('mode_shapes', 'bar-0000', material='steel');"
        "more = {name.split('.')[0] for name in set(sys.modules) - before - needed};"
        "sys.exit(' '.join(more - set(sys.stdlib_module_names) - {'vibraverse', 'numpy', 'h5py'}) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code, results / "dataset"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_control_characters_of_files_reach_no_shard(tmp_path):
    """HDF5 texts cannot hold NUL, but a mesh file may hold any byte."""
    paths = make_products.make(tmp_path, objects=("bar-0000", "leaf"))
    record = Path(paths.at(paths.source_record, object="bar-0000"))
    source = products.read_json(record)
    products.write_json(record, {**source, "title": "A\0bar", "attribution": "one\ntwo\x1b[2J"})
    said = Refused("unreadable", "line 1: 'v\0 0'", "Look\0at it.")
    for path in Path(paths.at(paths.object, object="leaf")).rglob("*"):
        refusal = read_refusal(path)
        if refusal:
            products.write_text(path, replace(refusal, message="v\0 0", advice=said.advice).to_text())
    (shard,) = make_products.pack(tmp_path, groups=(("bar-0000", "leaf"),))
    assert problems(shard) == []
    with vibraverse.dataset.open(shard) as reader:
        assert {row["title"] for row in reader.items} == {"A bar"}
        assert reader.read("attribution", "bar-0000") == "one\ntwo [2J"
        assert reader.refusals[0]["message"] == "v 0"
    assert str(said) == "line 1: 'v  0' Look at it."


def test_the_documentation_holds_the_schema(root):
    text = (root / "docs/dataset.md").read_text(encoding="utf-8")
    assert schema.markdown() in text, (
        "docs/dataset.md: replace its tables by vibraverse.dataset.schema.markdown()"
    )
