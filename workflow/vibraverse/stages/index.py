"""Stage ``index``: all shards in, the tables and the record of the dataset out; assigns every object's split."""

from __future__ import annotations

from vibraverse.contract import products
from vibraverse.contract.stage import Job
from vibraverse.contract.texts import unknown


def run(job: Job) -> None:
    """Write the tables, the card, the record and the checksums of the dataset."""
    from vibraverse.contract.errors import UsageError
    from vibraverse.dataset.publish.card import card, overview
    from vibraverse.dataset.publish.croissant import croissant
    from vibraverse.dataset.read.reader import Reader
    from vibraverse.dataset.schema import INDEX_COLUMNS, REFUSAL_COLUMNS, SPLIT_COLUMNS
    from vibraverse.dataset.schema.tables import to_tsv
    from vibraverse.dataset.write.columns import write_index
    from vibraverse.dataset.write.parquet import write_parquet
    from vibraverse.dataset.write.summary import summary

    if "config" in job.final:
        if "resolved" not in job.inputs:
            raise UsageError("index: --config needs the configuration to copy; name it with --resolved")
        job.outputs["config"].write_bytes(job.inputs["resolved"].read_bytes())
    try:
        reader = Reader(job.inputs["shards"])
    except ValueError as error:  # a file that is not a shard, or follows another schema
        raise UsageError(f"index: {error}") from None
    with reader:
        splits = _splits(job, reader)
        reader.place(splits.split)
        job.outputs["splits"].write_text(to_tsv(splits.rows(), SPLIT_COLUMNS), encoding="utf-8")
        with job.outputs["index"].open("w", encoding="utf-8") as file:
            file.writelines(reader.index.items.tsv(INDEX_COLUMNS))
        write_index(job.outputs["columns"], reader.index)
        write_parquet(job.outputs["parquet"], reader.index.items, INDEX_COLUMNS)
        job.outputs["refusals"].write_text(to_tsv(reader.refusals, REFUSAL_COLUMNS), encoding="utf-8")
        found = {**summary(reader, job.options.splits), "copies": splits.summary()}
        attributions = [reader.group(name).attrs["attribution"] for name in reader.objects]
        job.outputs["overview"].write_bytes(overview(reader))
    shards = {path.name: _facts(path) for path in job.inputs["shards"]}
    about = job.options.card
    text = card(found, about, attributions, job.final["overview"].name)
    job.outputs["card"].write_text(text, encoding="utf-8")
    described = {f"{name}.tsv": _facts(job.outputs[name]) for name in ("index", "splits", "refusals")}
    described |= {f"shards/{name}": facts for name, facts in shards.items()}
    products.write_json(job.outputs["croissant"], croissant(found, about, described))
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


def _splits(job: Job, reader):
    """Return the split of every object, from the hash of its id and its copies."""
    from vibraverse.contract.errors import UsageError
    from vibraverse.dataset.read.index import read_splits
    from vibraverse.dataset.split.assignment import assign
    from vibraverse.dataset.split.copies import fingerprints_of, groups

    options, kept = job.options, None
    if "kept" in job.inputs:
        try:
            kept = read_splits(job.inputs["kept"])
        except (UnicodeDecodeError, ValueError) as error:
            raise UsageError(
                f"index: {job.inputs['kept']} is not the splits.tsv of a dataset: {error}; name another "
                "file with --kept"
            ) from None
        for name in sorted(set(kept.values()) - set(options.splits)):
            raise UsageError(f"index: {job.inputs['kept']}: {unknown('split', name, options.splits)}")
    strata = None
    if options.stratify != "none":
        columns = (reader.items.column(name).tolist() for name in ("object", options.stratify))
        strata = dict(zip(*columns, strict=True))
    return assign(groups(fingerprints_of(reader, reader.objects)), options.splits, strata, kept)


def _facts(path) -> dict:
    """Return the checksum and the size of a file."""
    return {"sha256": products.sha256(path), "bytes": path.stat().st_size}
