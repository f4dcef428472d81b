"""The columnar index: the same rows however it is opened, and none of it in a pickle."""

from __future__ import annotations

import ast
import json
import pickle
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

import make_products
import vibraverse.dataset
from vibraverse.contract.products import sha256
from vibraverse.dataset import schema
from vibraverse.dataset.check import folder
from vibraverse.dataset.read import index as reading
from vibraverse.dataset.schema.columns import Table, Texts, joined
from vibraverse.dataset.schema.tables import from_tsv, to_tsv

#: What a pickled reader may take: so many bytes, and so many for each item of a part of the dataset.
PICKLED, AN_ITEM, A_SAMPLED_ITEM = 2_000, 4, 8
COLUMNS = {"object": (str, ""), "mass": (float, ""), "count": (int, "")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    return Path(make_products.build(tmp_path_factory.mktemp("columns") / "results").dataset)


@pytest.fixture
def dataset(whole, tmp_path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "dataset"))


@pytest.fixture
def from_shards(monkeypatch) -> list:
    """The folders whose index had to be read from the shards."""
    asked = []
    kept = reading.of_shards
    monkeypatch.setattr(reading, "of_shards", lambda *arguments: asked.append(arguments) or kept(*arguments))
    return asked


def contents(path) -> tuple:
    with vibraverse.dataset.open(path) as reader:
        return list(reader.items), reader.refusals, reader.objects, reader.index.shard_of


def stale(dataset: Path) -> None:
    """Change a checksum in dataset.json."""
    record = json.loads((dataset / "dataset.json").read_text())
    record["files"]["index.h5"]["sha256"] = "0" * 64
    (dataset / "dataset.json").write_text(json.dumps(record))


def flipped(dataset: Path) -> None:
    content = bytearray((dataset / "index.h5").read_bytes())
    content[len(content) // 2] ^= 1
    (dataset / "index.h5").write_bytes(content)


def grown(dataset: Path) -> None:
    """Change the size of a shard, as packing it again would."""
    with h5py.File(dataset / "shards/1.h5", "r+") as h5:
        h5.attrs["more"] = np.zeros(5000)


def missing(dataset) -> None:
    (dataset / "index.h5").unlink()


@pytest.mark.parametrize("change", [missing, stale, flipped, grown])
def test_without_a_right_file_the_shards_say_the_same(whole, dataset, from_shards, capfd, change):
    expected = contents(whole)
    assert not from_shards
    change(dataset)
    assert contents(dataset) == expected
    assert len(from_shards) == 1
    assert capfd.readouterr() == ("", "")


def test_splits_changed_by_hand_are_those_of_the_reader(dataset):
    table = dataset / "splits.tsv"
    rows = from_tsv(table.read_text(), schema.SPLIT_COLUMNS)
    other = {"train": "tests", "tests": "train", "test": "train", "validation": "train"}
    changed = [{**row, "split": other[row["split"]]} for row in rows]
    table.write_text(to_tsv(changed, schema.SPLIT_COLUMNS))
    with vibraverse.dataset.open(dataset) as reader:
        found = {item["object"]: item["split"] for item in reader.items}
    assert found == {row["object"]: row["split"] for row in changed}


def test_the_file_holds_the_rows_of_the_tables(whole):
    items, refusals, _, shards = contents(whole)
    assert items == from_tsv((whole / "index.tsv").read_text(), schema.INDEX_COLUMNS)
    assert refusals == from_tsv((whole / "refusals.tsv").read_text(), schema.REFUSAL_COLUMNS)
    assert shards == {"ball-0000": "0.h5", "leaf": "0.h5", "bar-0000": "1.h5"}
    with h5py.File(whole / "index.h5") as h5:
        assert h5["items/mass_kg"].attrs["description"] == "mass of the body"
        assert h5["items/solidity"].dtype == np.uint8


def test_a_row_that_differs_from_the_shards_is_named(dataset):
    with h5py.File(dataset / "index.h5", "r+") as h5:
        h5["items/mass_kg"][5] = 1.0
    (finding,) = folder.findings(dataset)
    assert (finding.file, finding.object) == ("index.h5", "bar-0000")
    assert finding.sentence.startswith("row 6 of items is not what the shards say: ")


def test_narrowing_compares_as_the_rows_do(whole):
    with vibraverse.dataset.open(whole) as reader:
        every = reader.with_sampled()
        masses = [item["mass_kg"] for item in every.items]
        assert every.items.column("mass_kg").tolist() == masses
        assert every.items.column("material").tolist() == [item["material"] for item in every.items]
        for conditions in (
            {"material": ["sampled-0001", "steel"], "solidity": "hollow"},
            {"mass_kg": masses[5]},
            {"mass_kg": [masses[0], masses[-1], "steel"]},
            {"modes": 64.0, "sampled": np.int64(3)},
            {"modes": "64"},
            {"object": ()},
        ):
            allowed = {
                name: {value} if isinstance(value, (str, float, np.integer)) else set(value)
                for name, value in conditions.items()
            }
            expected = [item for item in every.items if all(item[name] in allowed[name] for name in allowed)]
            assert list(every.where(**conditions).items) == expected
        assert list(every.with_sampled().items) == list(every.items)
        assert every.items[-1] == every.items[len(every) - 1] == list(every.items)[-1]
        with pytest.raises(IndexError):
            every.items[len(every)]


def test_a_reader_s_pickle_holds_no_index(whole):
    with vibraverse.dataset.open(whole) as reader:
        list(reader.items)  # every column was read
        some = reader.where(material=["steel", "glass"])
        every = some.with_sampled()
        for part, size in ((reader, 0), (some, AN_ITEM), (every, A_SAMPLED_ITEM)):
            pickled = pickle.dumps(part)
            assert len(pickled) <= PICKLED + size * len(part)
            again = pickle.loads(pickled)
            assert list(again.items) == list(part.items)
            np.testing.assert_array_equal(again[1]["frequencies_hz"], part[1]["frequencies_hz"])
            again.close()
        fresh = vibraverse.dataset.fresh_materials(whole)
        assert len(pickle.dumps(fresh)) <= PICKLED + AN_ITEM * len(fresh)
    rows = np.arange(800_000, dtype=np.int32)
    assert len(pickle.dumps(rows)) <= PICKLED + AN_ITEM * len(rows)


def test_a_pickle_of_another_index_is_not_read(dataset):
    with vibraverse.dataset.open(dataset) as reader:
        pickled = pickle.dumps(reader.where(material="steel"))
    flipped(dataset)
    with pytest.raises(OSError, match="was written anew since it was opened; open the dataset again"):
        pickle.loads(pickled)


def test_columns_of_a_replaced_file_are_not_read(dataset):
    with vibraverse.dataset.open(dataset) as reader:
        assert reader.items.column("object").item(0) == "ball-0000"
        shutil.copy(dataset / "index.h5", dataset / "new.h5")
        (dataset / "new.h5").replace(dataset / "index.h5")
        assert reader.items.column("object").item(0) == "ball-0000"  # read before
        with pytest.raises(OSError, match="open the dataset again"):
            reader.items.column("mass_kg")


def test_tables_by_column_are_written_as_those_of_rows():
    rows = [
        {"object": f"o\t{number % 3} ", "mass": 0.1 * number, "count": number} for number in range(20_000)
    ]
    table = Table.from_tsv(to_tsv(rows, COLUMNS), COLUMNS)
    assert "".join(table.tsv(COLUMNS)) == to_tsv(rows, COLUMNS)
    ordered = joined([table.take(np.array([5, 2])), table.take(table.column("count") == 1)], COLUMNS)
    assert ordered.column("count").tolist() == [5, 2, 1]
    assert ordered.sorted_by("object").column("count").tolist() == [1, 5, 2]
    assert Table.from_tsv("object\tmass\tcount\n", COLUMNS).column("object").tolist() == []
    for wrong in ("object\tmass\n", "object\tmass\tcount\na\t1\n", "object\tmass\tcount\na\t1\tx\n"):
        with pytest.raises(ValueError, match=r"columns are|shorter|invalid literal"):
            Table.from_tsv(wrong, COLUMNS)
    many = Texts.of(str(number) for number in range(300))
    assert (many.codes.dtype, many.ranks().tolist()[10]) == (np.uint16, 2)
    assert many[np.array([7, 3, 7])].compact().values == ["7", "3"]


def test_the_same_rows_give_the_same_file(whole, tmp_path):
    from vibraverse.dataset.write.columns import write_index

    shards = reading.shards_at(whole)
    index = reading.of_shards(reversed(shards), reading.splits_at(whole))
    write_index(tmp_path / "again.h5", index)
    assert sha256(tmp_path / "again.h5") == sha256(whole / "index.h5")


def test_rooms_of_the_dataset_import_in_one_direction():
    """schema, split, read, write, then check and publish; lazy imports count."""
    order = {"schema": 0, "split": 1, "read": 2, "write": 3, "check": 4, "publish": 4}
    root = Path(vibraverse.dataset.__file__).parent
    seen = 0
    for module in root.rglob("*/*.py"):
        here = module.relative_to(root).parts[0]
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            for name in imported(node):
                parts = name.split(".")
                assert parts[1] not in ("stages", "commands"), (module, name)
                assert parts[1:3] != ["flow", "plan"], (module, name)
                if parts[1] == "dataset" and len(parts) > 2 and parts[2] in order and parts[2] != here:
                    assert order[parts[2]] < order[here], (module, name)
                    seen += 1
    assert seen > 20


def imported(node) -> list[str]:
    """Return this project's modules that a statement imports."""
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.module:
        names = [f"{node.module}.{alias.name}" for alias in node.names]
    else:
        names = []
    return [name for name in names if name.startswith("vibraverse.")]
