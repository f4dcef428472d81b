"""Indexing: what all shards hold, as two tables and one record."""

from __future__ import annotations

from vibraverse import products
from vibraverse.stage import Job, Stage


def run(job: Job) -> None:
    """Join the shards' rows, and count."""
    from vibraverse.cli import UsageError
    from vibraverse.dataset.parquet import write_parquet
    from vibraverse.dataset.reader import Reader
    from vibraverse.dataset.schema import INDEX_COLUMNS, REFUSAL_COLUMNS
    from vibraverse.dataset.summary import summary
    from vibraverse.dataset.tables import to_tsv

    if "config" in job.final:
        if "resolved" not in job.inputs:
            raise UsageError("index: --config needs the configuration to copy; name it with --resolved.")
        job.outputs["config"].write_bytes(job.inputs["resolved"].read_bytes())
    try:
        reader = Reader(job.inputs["shards"])
    except ValueError as error:  # a file that is no shard, or follows another schema
        raise UsageError(f"index: {error}") from None
    with reader:
        job.outputs["index"].write_text(to_tsv(reader.items, INDEX_COLUMNS), encoding="utf-8")
        write_parquet(job.outputs["parquet"], reader.items, INDEX_COLUMNS)
        job.outputs["refusals"].write_text(to_tsv(reader.refusals, REFUSAL_COLUMNS), encoding="utf-8")
        found = summary(reader)
    shards = {path.name: _facts(path) for path in job.inputs["shards"]}
    tables = {
        job.final[name].name: _facts(job.outputs[name])
        for name in job.final
        if name not in ("record", "sums")
    }
    job.write_record({**found, "shards": shards, "files": tables})
    sums = {f"shards/{name}": facts["sha256"] for name, facts in shards.items()}
    sums |= {name: facts["sha256"] for name, facts in tables.items()}
    sums[job.final["record"].name] = products.sha256(job.outputs["record"])
    lines = (f"{digest}  {name}\n" for name, digest in sums.items())
    job.outputs["sums"].write_text("".join(lines), encoding="utf-8")


def _facts(path) -> dict:
    """Return the checksum and the size of a file."""
    return {"sha256": products.sha256(path), "bytes": path.stat().st_size}


STAGE = Stage(
    name="index",
    help="write the dataset's index, refusals and record",
    inputs={
        "shards": "all shards (HDF5)",
        "resolved": "configuration of the run, with every default filled in",
    },
    outputs={
        "index": "index.tsv: one row per object, solidity and material",
        "parquet": "index.parquet: the same rows",
        "refusals": "refusals.tsv: one row per refused object or body",
        "record": "dataset.json: counts, materials, ranges, versions, checksums",
        "config": "config.yaml: that configuration, beside the dataset",
        "sums": "SHA256SUMS: checksums of all files, for `sha256sum -c`",
    },
    run=run,
    many=frozenset({"shards"}),
    optional=frozenset({"resolved", "config"}),
    libraries=("numpy", "h5py", "pyarrow"),
    per_object=False,
    passes_refusals=False,
)
