"""Exports: formats of other programs, with the content of the dataset."""

from __future__ import annotations

import io
import json
import tarfile

import numpy as np
import pyarrow.parquet as pq
import pytest
import soundfile

import make_products
import vibraverse.dataset
from vibraverse.contract.products import read_json, sha256


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    results = tmp_path_factory.mktemp("export") / "results"
    make_products.build(results)
    return results / "dataset"


@pytest.fixture
def export(folder, tmp_path, vibraverse):
    def call(*arguments, status=0):
        found, out, err = vibraverse("export", folder, "-o", tmp_path / "out", *arguments)
        assert found == status, err
        return tmp_path / "out", out if status == 0 else err

    return call


def samples(tars) -> dict[str, dict[str, bytes]]:
    """Group the members of tars as WebDataset does: by the name up to the first dot."""
    found: dict[str, dict[str, bytes]] = {}
    for path in sorted(tars):
        with tarfile.open(path) as tar:
            for member in tar:
                key, _, kind = member.name.partition(".")
                found.setdefault(key, {})[kind] = tar.extractfile(member).read()
    return found


def test_webdataset_holds_every_item(export, folder):
    out, _ = export(
        "--format", "webdataset", "--fields", "frequencies_hz,young_pa,occupancy,sound,views,clean"
    )
    found = samples(out.glob("*.tar"))
    assert len(found) == 12
    item = found["bar-0000__hollow__wood"]
    assert set(item) == {"json", "frequencies_hz.npy", "occupancy.npy", "wav", "00.png", "01.png", "02.png"}
    with vibraverse.dataset.open(folder) as reader:
        place = ("bar-0000", "hollow", "wood")
        array = np.load(io.BytesIO(item["frequencies_hz.npy"]))
        np.testing.assert_array_equal(array, reader.read("frequencies_hz", *place))
        samples_, rate = soundfile.read(io.BytesIO(item["wav"]), dtype="float32")
        np.testing.assert_array_equal(samples_, reader.read("sound", *place))
        assert rate == reader.read("sample_rate_hz", *place)
        assert item["01.png"] == reader.group("bar-0000")["views/clay"][1].tobytes()
        about = json.loads(item["json"])
        assert about["young_pa"] == 1.1e10
        assert about["clean"] == reader.read("clean", "bar-0000")
        splits = {one["object"]: one["split"] for one in reader.items}
    assert about["split"] == splits["bar-0000"]
    for path in out.glob("*.tar"):
        objects = {key.split("__")[0] for key in samples([path])}
        assert {splits[one] for one in objects} == {path.name.split("-0")[0]}
    record = read_json(out / "export.json")
    assert record["items"] == 12
    assert {name: about["sha256"] for name, about in record["files"].items()} == {
        path.name: sha256(path) for path in out.glob("*.tar")
    }


def test_files_are_bounded_and_repeat_to_the_byte(export, folder, tmp_path, vibraverse):
    arguments = ("--format", "webdataset", "--fields", "occupancy,mode_shapes,views", "--max-mb", 0.2)
    out, _ = export(*arguments)
    assert len(list(out.glob("*.tar"))) > 3
    assert all(path.stat().st_size < 0.22 * 2**20 for path in out.glob("*.tar"))
    assert vibraverse("export", folder, "-o", tmp_path / "again", *arguments)[0] == 0
    assert read_json(out / "export.json") == read_json(tmp_path / "again/export.json")
    assert len(samples(out.glob("*.tar"))) == 12


def tables(out) -> list[pq.ParquetFile]:
    return [pq.ParquetFile(path) for path in sorted(out.glob("data/*.parquet"))]


def test_huggingface_rows_with_sounds_and_pictures(export, folder):
    fields = "frequencies_hz,signed_distance,sound,views"
    out, _ = export("--format", "huggingface", "--sampled", "--fields", fields)
    rows = [row for table in tables(out) for row in table.read().to_pylist()]
    assert len(rows) == 12 + 9
    row = next(
        one
        for one in rows
        if (one["object"], one["solidity"], one["material"]) == ("bar-0000", "solid", "wood")
    )
    sampled = next(one for one in rows if one["material"] == "sampled-0001")
    assert sampled["sound"] is None
    with vibraverse.dataset.open(folder) as reader:
        for name in ("frequencies_hz", "signed_distance"):
            true = reader.read(name, "bar-0000", "solid", "wood")
            np.testing.assert_array_equal(np.array(row[name], dtype=true.dtype), true)
        heard = soundfile.read(io.BytesIO(row["sound"]["bytes"]), dtype="float32")[0]
        np.testing.assert_array_equal(heard, reader.read("sound", "bar-0000", "solid", "wood"))
        shown = reader.group("bar-0000")["views/clay"]
        assert [one["bytes"] for one in row["views"]] == [one.tobytes() for one in shown]
        splits = sorted({one["split"] for one in reader.items})
    text = (out / "README.md").read_text(encoding="utf-8")
    assert text.startswith("---\nconfigs:\n")
    for split in splits:
        assert f"  - split: {split}\n    path: data/{split}-*.parquet\n" in text


def test_every_file_states_the_features_of_datasets(export):
    out, _ = export("--format", "huggingface", "--sampled")
    stated = {table.schema_arrow.metadata[b"huggingface"] for table in tables(out)}
    assert len(stated) == 1
    features = json.loads(stated.pop())["info"]["features"]
    assert features["sound"] == {"_type": "Audio"}
    assert features["views"] == [{"_type": "Image"}]
    assert features["material"] == {"_type": "Value", "dtype": "string"}
    assert features["occupancy"] == [[[{"_type": "Value", "dtype": "uint8"}]]]
    assert list(features) == tables(out)[0].schema_arrow.names


def test_pictures_of_an_object_are_stored_once_in_a_file(export, folder):
    out, _ = export("--format", "huggingface", "--fields", "views", "--where", "object=bar-0000")
    (table,) = tables(out)
    with vibraverse.dataset.open(folder) as reader:
        once = sum(len(one.tobytes()) for one in reader.group("bar-0000")["views/clay"])
    assert table.metadata.num_rows > 3
    stored = sum(
        column.total_uncompressed_size
        for column in (table.metadata.row_group(0).column(i) for i in range(table.metadata.num_columns))
        if column.path_in_schema == "views.list.element.bytes"
    )
    assert once <= stored < 2 * once < table.metadata.num_rows * once


def test_narrowed(export):
    out, said = export("--format", "webdataset", "--where", "material=steel,wood", "solidity=solid")
    assert sorted(samples(out.glob("*.tar"))) == [
        f"{name}-0000__solid__{material}" for name in ("ball", "bar") for material in ("steel", "wood")
    ]
    assert said.splitlines()[-1].startswith("4 items in ")


def test_a_column_may_be_named_again_and_numbers_are_numbers(export):
    again = ("material=steel", "material=wood", "modes=64", "size_m=0.180")
    out, _ = export("--format", "webdataset", "--where", *again, "solidity=solid")
    assert sorted(samples(out.glob("*.tar"))) == [
        f"{name}-0000__solid__{material}" for name in ("ball", "bar") for material in ("steel", "wood")
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--format", "huggingface", "--fields", "signed_distanse"), "did you mean 'signed_distance'?"),
        (("--format", "webdataset", "--where", "material"), "--where takes COLUMN=VALUE, not 'material'"),
        (
            ("--format", "webdataset", "--where", "materal=wood"),
            "unknown column 'materal'; did you mean 'material'?",
        ),
        (
            ("--format", "webdataset", "--where", "material=stell", "solidity=solid"),
            "matches --where: unknown material 'stell'; did you mean 'steel'? (known: ceramic, glass, steel, wood)",
        ),
        (
            ("--format", "webdataset", "--where", "size_m=0.2"),
            "size_m is 0.2 in no item; take one of the nearest values: 0.18",
        ),
        (
            ("--format", "webdataset", "--where", "object=ball-0000", "solidity=hollow"),
            "matches --where object=ball-0000 solidity=hollow: each value occurs, but not together",
        ),
        (("--format", "webdataset", "--where", "modes=many"), "--where modes must be a number, not 'many'"),
        (("--format", "webdataset", "--max-mb", "0"), "--max-mb must be greater than 0, not 0"),
    ],
)
def test_a_mistake_is_one_sentence(export, arguments, words):
    _, said = export(*arguments, status=2)
    assert words in said
    assert len(said.strip().splitlines()) == 1


def test_a_value_that_occurs_nowhere_beside_one_that_does_is_said(folder, tmp_path, vibraverse):
    arguments = ("--format", "webdataset", "--where", "material=wood,tin")
    status, _, said = vibraverse("export", folder, "-o", tmp_path / "out", *arguments)
    assert status == 0
    assert said == (
        "vibraverse: export: passed over: unknown material 'tin' (known: ceramic, glass, steel, wood)\n"
    )


def test_what_is_there_is_not_overwritten(export, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine").write_text("mine")
    _, said = export("--format", "webdataset", status=2)
    assert "is not empty; name a new folder" in said


def test_the_folder_one_stands_in_is_not_replaced(folder, tmp_path, vibraverse, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, _, said = vibraverse("export", folder, "-o", ".", "--format", "webdataset")
    assert (status, said.count("\n")) == (2, 1)
    assert "cannot be replaced; name a new folder" in said


def test_what_fails_leaves_nothing(export, tmp_path):
    export("--format", "webdataset", "--fields", "sound,boundary_faces", status=2)  # a ball has none
    assert list(tmp_path.iterdir()) == []
