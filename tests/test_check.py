"""``vibraverse check``: every byte is covered, the wrong object is named, and numbers are recomputed."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import make_products
import vibraverse.dataset
from vibraverse.contract.products import sha256
from vibraverse.dataset.check import folder
from vibraverse.dataset.schema.checksums import checksums


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return Path(make_products.build(tmp_path_factory.mktemp("check") / "results").dataset)


@pytest.fixture
def dataset(whole, tmp_path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "dataset"))


@pytest.fixture
def in_this_process(monkeypatch):
    """Read shards in this process, and each state of one once: a child process per flip would cost a second."""
    read, known = folder._inside, {}

    def once(path: str, share: float):
        state = sha256(path), share
        if state not in known:
            known[state] = read(path, share)
        return known[state]

    monkeypatch.setattr(folder, "_inside", once)
    monkeypatch.setattr(folder, "run_limited", lambda function, *arguments, **_: function(*arguments))


def flip(path: Path, place: int, bit: int = 0) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 1 << bit
    path.write_bytes(content)


def rewrite(dataset: Path, shard: str, change) -> None:
    """Change a shard's content and correct all its checksums, as a faulty program would."""
    with h5py.File(dataset / "shards" / shard, "r+") as h5:
        change(h5["objects"])
        for group in h5["objects"].values():
            del group["checksums"]
            group["checksums"] = json.dumps(checksums(group))
    record = json.loads((dataset / "dataset.json").read_text())
    for name in record["shards"]:
        record["shards"][name]["sha256"] = sha256(dataset / "shards" / name)
    (dataset / "dataset.json").write_text(json.dumps(record))
    names = [line[66:] for line in (dataset / "SHA256SUMS").read_text().splitlines()]
    (dataset / "SHA256SUMS").write_text("".join(f"{sha256(dataset / name)}  {name}\n" for name in names))


def test_a_whole_dataset_passes_with_everything_recomputed(whole, vibraverse):
    status, out, _ = vibraverse("check", whole, "--sample", "1")
    assert (status, out) == (
        0,
        f"{whole} is as it was written, and agrees with itself (100% of its items recomputed).\n",
    )
    assert vibraverse("check", whole / "shards/1.h5")[0] == 0


def test_a_hundred_flipped_bytes_are_found(dataset, in_this_process):
    """Anywhere in a shard: data, structure or padding."""
    draw = random.Random(1)
    for _ in range(100):
        name = draw.choice(["0.h5", "1.h5"])
        shard = dataset / "shards" / name
        kept = shard.read_bytes()
        flip(shard, draw.randrange(len(kept)), draw.randrange(8))
        found = list(folder.findings(dataset))
        assert found
        assert {finding.file for finding in found} == {f"shards/{name}"}
        shard.write_bytes(kept)
    assert list(folder.findings(dataset)) == []


def stored(h5) -> list[tuple[str, int, int]]:
    """Return object, place in the file and length of every array in a shard."""
    found = []

    def visit(name, item):
        if isinstance(item, h5py.Dataset) and item.dtype.kind != "O":
            chunks = item.id.get_num_chunks() if item.chunks else 0
            where = [item.id.get_chunk_info(number) for number in range(chunks)]
            places = [(one.byte_offset, one.size) for one in where] or [(item.id.get_offset(), item.nbytes)]
            found.extend((name.split("/")[0], *place) for place in places if place[0] is not None)

    h5["objects"].visititems(visit)
    return found


def test_a_hundred_flips_in_arrays_name_their_object(dataset, in_this_process):
    draw = random.Random(2)
    arrays = {}
    for shard in sorted((dataset / "shards").iterdir()):
        with h5py.File(shard) as h5:
            arrays[shard] = stored(h5)
    for _ in range(100):
        shard = draw.choice(list(arrays))
        object_id, start, length = draw.choice(arrays[shard])
        kept = shard.read_bytes()
        flip(shard, start + draw.randrange(length), draw.randrange(8))
        first = next(folder.findings(dataset))
        assert (first.file, first.object) == (f"shards/{shard.name}", object_id), first
        shard.write_bytes(kept)


def test_a_wrong_byte_is_said_in_one_line_and_the_exit_code(dataset, vibraverse):
    shard = dataset / "shards/1.h5"
    with h5py.File(shard) as h5:
        place = h5["objects/bar-0000/solid/materials/steel/frequencies_hz"].id.get_offset()
    flip(shard, place + 4)
    status, out, _ = vibraverse("check", dataset)
    assert status == 1
    assert out.startswith(
        "shards/1.h5: bar-0000: not as it was written: solid/materials/steel/frequencies_hz\n"
    )


def test_a_shard_that_hdf5_cannot_open_is_a_finding(dataset):
    (dataset / "shards/0.h5").write_bytes(b"\0" * 1000)
    (finding,) = folder.findings(dataset)
    assert str(finding).startswith("shards/0.h5: HDF5 cannot open it")


def test_a_crash_of_hdf5_is_a_finding(dataset, monkeypatch):
    monkeypatch.setattr(folder, "_inside", crash)
    flip(dataset / "shards/0.h5", 100)
    (finding,) = folder.findings(dataset)
    assert str(finding).startswith("shards/0.h5: reading it crashed (SIGSEGV)")


def crash(path: str, share: float):
    import os
    import signal

    if path.endswith("0.h5"):
        os.kill(os.getpid(), signal.SIGSEGV)
    return []


@pytest.mark.parametrize(
    "name", ["index.tsv", "index.h5", "index.parquet", "refusals.tsv", "dataset.json", "SHA256SUMS"]
)
def test_flips_beside_the_shards_are_found(dataset, name, in_this_process):
    draw = random.Random(3)
    path = dataset / name
    kept = path.read_bytes()
    for _ in range(25):
        flip(path, draw.randrange(len(kept)), draw.randrange(8))
        found = list(folder.findings(dataset))
        # Of dataset.json and its line in SHA256SUMS either may be the wrong one.
        assert any(name in str(finding) for finding in found), found
        assert not any((dataset / finding.file).match("shards/[01].h5") for finding in found), found
        path.write_bytes(kept)


def test_a_wrong_line_of_the_index_names_its_object(dataset):
    index = dataset / "index.tsv"
    index.write_text(index.read_text().replace("bar-0000\tsolid\twood", "bar-0000\tsolid\tgold"))
    (finding,) = folder.findings(dataset)
    assert (finding.file, finding.object) == ("index.tsv", "bar-0000")


def test_lost_and_strange_files_are_named(dataset):
    shutil.copy(dataset / "shards/1.h5", dataset / "shards/7.h5")
    (dataset / "shards/1.h5").unlink()
    found = [str(finding) for finding in folder.findings(dataset)]
    assert "shards/1.h5: it is not there, but dataset.json and SHA256SUMS list it" in found
    assert "shards/7.h5: it is no file of this dataset: move it away" in found


def test_a_stranger_is_one_finding_and_nothing_of_ours_is_deleted(dataset, vibraverse):
    (dataset / "notes.txt").write_text("mine")
    (dataset / "shards/.1.partial.0.h5").write_text("of a killed job")
    (finding,) = folder.findings(dataset)
    assert str(finding) == "notes.txt: it is no file of this dataset: move it away"
    before = sorted(dataset.rglob("*"))
    status, out, _ = vibraverse("repair", "--results", dataset.parent, "--delete")
    assert (status, out) == (1, f"{dataset}/notes.txt: {finding.sentence}\n")
    assert sorted(dataset.rglob("*")) == before
    (dataset / "notes.txt").unlink()
    assert vibraverse("repair", "--results", dataset.parent, "--delete")[0] == 0


@pytest.mark.parametrize("witness", ["dataset.json", "SHA256SUMS"])
def test_without_checksum_lists_no_file_is_a_stranger(dataset, witness):
    (dataset / witness).write_text("")
    found = list(folder.findings(dataset))
    assert found
    assert not any(finding.stranger for finding in found)


@pytest.mark.parametrize("looks", [[], ["clay"]])
def test_pictures_are_missing_only_where_some_were_made(tmp_path, looks):
    paths = make_products.make(tmp_path, objects=("bar-0000",))
    record = Path(paths.at(paths.images_record, object="bar-0000"))
    images = json.loads(record.read_text())
    images["provenance"]["options"]["looks"] = looks
    record.write_text(json.dumps(images))
    shard = tmp_path / "0.h5"
    make_products.call(
        "dataset", "--shard", shard, "--options", make_products.options(tmp_path, ["bar-0000"], looks=[])
    )
    found = [finding.sentence for finding in folder.findings(shard)]
    assert found == (["views/{look} is missing"] if looks else [])


def scaled(path: str, factor: float):
    def change(objects):
        objects[path][...] = objects[path][()] * factor

    return change


def without(path: str):
    def change(objects):
        del objects[path]

    return change


def with_attribute(path: str, name: str, value):
    def change(objects):
        objects[path].attrs[name] = value

    return change


def with_text(path: str, text: str):
    def change(objects):
        del objects[path]
        objects[path] = text

    return change


def turned(path: str):
    """Change two modes, one of them slightly; two others are then no longer orthogonal to them."""

    def change(objects):
        objects[path][0] = objects[path][0][::-1]
        objects[path][7] += np.float32(0.01) * objects[path][8]

    return change


STEEL = "bar-0000/solid/materials/steel"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (without("bar-0000/grids/occupancy"), "grids/occupancy is missing"),
        (without(f"{STEEL}/damping_per_s"), "solid/materials/steel/damping_per_s is missing"),
        (scaled("bar-0000/surface/vertices", 2.0), "surface/vertices holds numbers from -1.8 to 1.8, outside [-1, 1]"),
        (scaled(f"{STEEL}/frequencies_hz", np.nan), "frequencies_hz holds 64 numbers that are not finite"),
        (scaled(f"{STEEL}/damping_per_s", 1.001), "steel: damping_per_s is not ½(α + β ω²)"),
        (with_attribute(STEEL, "mass_kg", 1.0), "steel: mass_kg = 1 is not density times volume"),
        (with_attribute(STEEL, "poisson", 0.5), "solid/materials/steel@poisson holds numbers from 0.5 to 0.5"),
        (with_attribute("bar-0000/solid", "size_m", 1.0), "solid: scale_m = 0.1 is not size_m / 1.8"),
        (scaled("bar-0000/solid/basis/reduced/mu", 1.001), "[0, 1, 2, 3, 4, 5, 6, 7] and 56 more are no modes of the"),
        (scaled("bar-0000/solid/sampled/frequencies_hz", 1.001), "sampled-0000: frequencies_hz[18] = "),
        (scaled("bar-0000/shape/spectrum", 1.001), "shape/spectrum is not that of the solid body's stored basis"),
        (turned(f"{STEEL}/mode_coefficients"), "steel: mode_coefficients[0, 7, 8, 63] are no modes of the"),
        (scaled("bar-0000/solid/sounds/steel", 0.999), "the sound steel differs by"),
        (with_attribute("bar-0000", "title", 3), "@title is no text"),
        (with_text("bar-0000/clean", "{"), "clean holds no record (JSON)"),
        (with_attribute("bar-0000", "category", "spoon"), "the index says category = 'bar', the group 'spoon'"),
    ],
)  # fmt: skip
def test_what_no_checksum_can_tell_is_found(dataset, change, sentence):
    rewrite(dataset, "1.h5", change)
    found = list(folder.findings(dataset, share=1.0))
    assert found
    assert {(finding.file, finding.object) for finding in found} == {("shards/1.h5", "bar-0000")}
    assert any(sentence in finding.sentence for finding in found), found


def test_shapes_agree_with_each_other(dataset):
    def change(objects):
        place = objects[f"{STEEL}/mode_coefficients"]
        unit, coefficients = place.attrs["unit"], place[:, :-1]
        del objects[f"{STEEL}/mode_coefficients"]
        objects[f"{STEEL}/mode_coefficients"] = coefficients
        objects[f"{STEEL}/mode_coefficients"].attrs["unit"] = unit

    rewrite(dataset, "1.h5", change)
    (finding,) = folder.findings(dataset)
    assert "solid: steel: mode_coefficients has 63 columns, not 64 or 68" in finding.sentence


def solved_directly(vertices: int):
    """Store a material's shapes in full on this many vertices, as for a material solved on the mesh."""

    def change(objects):
        steel = objects[STEEL]
        del steel["mode_coefficients"]
        steel["mode_shapes"] = np.ones((64, vertices, 3), np.float32)
        steel["mode_shapes"].attrs["unit"] = "kg^-1/2"
        steel.attrs["solved_directly"] = True

    return change


def test_a_material_solved_on_the_mesh_has_its_shapes_as_they_are(dataset):
    rewrite(dataset, "1.h5", solved_directly(26))
    assert not list(folder.findings(dataset, share=1.0))
    with vibraverse.dataset.open(dataset) as reader:
        np.testing.assert_array_equal(
            reader.read("mode_shapes", "bar-0000", "solid", "steel"), np.ones((64, 26, 3))
        )
        others = reader.read("mode_shapes", "bar-0000", "solid", "wood")
        assert not np.array_equal(others, np.ones((64, 26, 3)))


@pytest.mark.parametrize(
    ("vertices", "directly", "sentence"),
    [
        (25, True, "solid/materials/steel/mode_shapes has shape (64, 25, 3), not (m, V, 3) with V = 26"),
        (26, False, "solid/materials/steel/mode_coefficients is missing"),
    ],
)
def test_shapes_that_are_stored_are_those_of_a_solve_on_the_mesh(dataset, vertices, directly, sentence):
    def change(objects):
        solved_directly(vertices)(objects)
        objects[STEEL].attrs["solved_directly"] = directly

    rewrite(dataset, "1.h5", change)
    (finding,) = folder.findings(dataset)
    assert sentence in finding.sentence


def test_an_older_schema_is_one_sentence(dataset, vibraverse, tmp_path):
    shard = dataset / "shards/1.h5"
    with h5py.File(shard, "r+") as h5:
        h5.attrs["format_version"] = 2
    sentence = (
        "it follows version 2 of the schema and this is version 3; delete it and run the workflow again"
    )
    status, out, _ = vibraverse("check", shard)
    assert status == 1
    assert out.startswith(f"1.h5: {sentence}")
    tables, others = ["index", "columns", "parquet", "splits", "refusals"], ["record", "card", "overview"]
    names = [*tables, *others, "croissant", "sums"]
    outputs = [part for name in names for part in (f"--{name}", tmp_path / name)]
    status, _, errors = vibraverse("index", "--shards", shard, *outputs)
    assert status == 2
    assert errors.splitlines()[-1].startswith(f"vibraverse: index: {shard}: {sentence}")
    assert not any((tmp_path / name).exists() for name in ("index", "parquet", "record", "sums"))


def test_what_is_no_shard_is_no_dataset(dataset, tmp_path, vibraverse):
    strange = tmp_path / "other.h5"
    with h5py.File(strange, "w") as h5:
        h5["x"] = 1
    table = dataset / "index.tsv"
    for path, sentence in (
        (strange, "this is not a shard: its attribute 'format' is not 'vibraverse-shard'"),
        (table, "HDF5 cannot open it"),
    ):
        status, out, errors = vibraverse("check", path)
        assert (status, out) == (2, "")
        assert errors.splitlines()[-1].startswith(f"vibraverse: {path} is no shard of a dataset: {sentence}")
    shutil.move(dataset, tmp_path / "results/dataset")
    status, _, errors = vibraverse("check", tmp_path / "results")
    assert status == 2
    assert errors.strip().endswith(f"; there is one in {tmp_path / 'results/dataset'}")
    shard = tmp_path / "results/dataset/shards/1.h5"
    shard.write_bytes(b"broken" + shard.read_bytes()[6:])
    status, out, _ = vibraverse("check", shard)
    assert status == 1
    assert "1 finding; " in out


def test_no_dataset_is_one_sentence(tmp_path, vibraverse):
    status, _, errors = vibraverse("check", tmp_path)
    assert status == 2
    assert "holds no finished dataset" in errors
