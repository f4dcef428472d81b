"""The index: every body of every shard, every refusal, and numbers that agree with both."""

from __future__ import annotations

import csv

import pytest

import make_products
from vibraverse.contract import products
from vibraverse.dataset import schema
from vibraverse.dataset.schema.columns import Table
from vibraverse.dataset.schema.tables import from_tsv
from vibraverse.dataset.write.parquet import write_parquet
from vibraverse.flow.paths import Paths


@pytest.fixture(scope="module")
def paths(tmp_path_factory) -> Paths:
    return make_products.build(tmp_path_factory.mktemp("index") / "results")


def rows_of(path) -> list[dict]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


def test_one_row_per_object_body_and_material(paths):
    rows = rows_of(paths.index)
    keys = [(row["object"], row["solidity"], row["material"]) for row in rows]
    assert len(keys) == len(set(keys)) == 12
    assert keys[:2] == [("ball-0000", "solid", "ceramic"), ("ball-0000", "solid", "glass")]
    assert {row["shard"] for row in rows if row["object"] == "bar-0000"} == {"1.h5"}
    wood = next(row for row in rows if row["object"] == "bar-0000" and row["material"] == "wood")
    assert float(wood["mass_kg"]) == pytest.approx(750 * float(wood["volume_m3"]), rel=1e-12)
    assert float(wood["size_m"]) == make_products.SIZE_M
    assert wood["licence"] == "CC0-1.0"
    assert len({row["split"] for row in rows if row["object"] == "bar-0000"}) == 1


def test_parquet_holds_the_same_rows_with_their_types_and_meanings(paths, tmp_path):
    import pyarrow.parquet as pq

    table = pq.read_table(paths.index_parquet)
    with open(paths.index, encoding="utf-8") as file:
        assert table.to_pylist() == from_tsv(file.read(), schema.INDEX_COLUMNS)
    assert str(table.schema.field("mass_kg").type) == "double"
    assert table.schema.field("mass_kg").metadata == {b"description": b"mass of the body"}
    with open(paths.index, encoding="utf-8") as file:
        again = Table.from_tsv(file.read(), schema.INDEX_COLUMNS)
    write_parquet(tmp_path / "again", again, schema.INDEX_COLUMNS)
    assert products.sha256(tmp_path / "again") == products.sha256(paths.index_parquet)


def test_refusals_have_reasons_and_advice(paths):
    rows = rows_of(paths.refusals)
    assert [(row["object"], row["solidity"], row["stage"], row["reason"]) for row in rows] == [
        ("ball-0000", "hollow", "hollow", "too_thin"),
        ("leaf", "", "clean", "not_a_solid"),
    ]
    assert all(row["message"] and row["advice"] for row in rows)


def test_the_record_counts(paths):
    record = products.read_json(paths.dataset_record)
    assert record["counts"] == {
        "objects": 2,
        "refused_objects": 1,
        "bodies": 3,
        "refused_bodies": 1,
        "sounds": 12,
        "sampled_sounds": 0,
        "items": 12,
        "sampled": 9,
    }
    assert record["refusals_by_reason"] == {"not_a_solid": 1, "too_thin": 1}
    assert sum(record["objects_by_split"].values()) == 2
    assert record["materials"]["steel"]["young_pa"] == 2.0e11
    first = [float(row["f1_hz"]) for row in rows_of(paths.index)]
    assert record["ranges"]["f1_hz"] == {"min": min(first), "max": max(first)}
    assert record["made_by"]["tets"]["options"] == {"target_elements": 6000}
    assert record["made_by"]["sources"]["options"] == {"seed": "varies"}


def test_the_record_holds_the_shards_checksums(paths):
    record = products.read_json(paths.dataset_record)
    assert list(record["shards"]) == ["0.h5", "1.h5"]
    for name, shard in record["shards"].items():
        path = paths.at(paths.shard, shard=name.removesuffix(".h5"))
        assert (
            shard["sha256"] == products.sha256(path) == record["provenance"]["input_sha256"]["shards"][name]
        )


def test_an_empty_split_is_counted_and_said(paths):
    record = products.read_json(paths.dataset_record)
    held = record["objects_by_split"]
    assert set(held) == {"train", "validation", "test"}
    assert sum(held.values()) == 2
    assert 0 in held.values()
    with open(paths.card, encoding="utf-8") as file:
        card = file.read()
    for name, count in held.items():
        assert f"| {name} | {count} |" in card
    assert " no object: take more objects, " in card


def test_order_of_the_shards_does_not_matter(paths, tmp_path):
    shards = [paths.at(paths.shard, shard=number) for number in ("1", "0")]
    tables = ("index", "columns", "parquet", "splits", "refusals")
    names = (*tables, "record", "card", "overview", "croissant", "sums")
    outputs = [(f"--{name}", tmp_path / name) for name in names]
    make_products.call("index", "--shards", *shards, *sum(outputs, ()))
    same = {
        "index": paths.index,
        "splits": paths.splits,
        "overview": paths.overview,
        "columns": paths.index_columns,
        "parquet": paths.index_parquet,
    }
    for name, path in same.items():
        with open(path, "rb") as first:
            assert first.read() == (tmp_path / name).read_bytes()


def test_a_dataset_of_refusals_alone_is_indexed(tmp_path):
    make_products.make(tmp_path, objects=("leaf",))
    make_products.index(tmp_path, make_products.pack(tmp_path, groups=(("leaf",),)))
    record = products.read_json(Paths(tmp_path).dataset_record)
    assert record["counts"]["objects"] == 0
    assert record["counts"]["refused_objects"] == 1
    assert record["ranges"] == {}
