"""Indexing: what all shards hold, as two tables and one record."""

from __future__ import annotations

from vibraverse import products
from vibraverse.stage import Job, Stage


def run(job: Job) -> None:
    """Join the shards' rows, and count."""
    from vibraverse.dataset.reader import Reader
    from vibraverse.dataset.schema import INDEX_COLUMNS, REFUSAL_COLUMNS
    from vibraverse.dataset.summary import summary
    from vibraverse.dataset.tables import to_tsv

    with Reader(job.inputs["shards"]) as reader:
        job.outputs["index"].write_text(to_tsv(reader.items, INDEX_COLUMNS), encoding="utf-8")
        job.outputs["refusals"].write_text(to_tsv(reader.refusals, REFUSAL_COLUMNS), encoding="utf-8")
        found = summary(reader)
    shards = {
        path.name: {"sha256": products.sha256(path), "bytes": path.stat().st_size}
        for path in job.inputs["shards"]
    }
    job.write_record({**found, "shards": shards})


STAGE = Stage(
    name="index",
    help="write the dataset's index, refusals and record",
    inputs={"shards": "all shards (HDF5)"},
    outputs={
        "index": "index.tsv: one row per object, solidity and material",
        "refusals": "refusals.tsv: one row per refused object or body",
        "record": "dataset.json: counts, materials, ranges, versions, checksums",
    },
    run=run,
    many=frozenset({"shards"}),
    libraries=("numpy", "h5py"),
    per_object=False,
    passes_refusals=False,
)
