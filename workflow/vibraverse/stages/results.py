"""Stage ``results``: the measures of all models in, one table out."""

from __future__ import annotations

from vibraverse.contract import products
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Join the trainings of each model and split."""
    from vibraverse.dataset.schema.tables import to_tsv
    from vibraverse.learn.results import COLUMNS, table

    records = [products.read_json(path) for path in job.inputs["evaluations"]]
    baselines = [one for path in job.inputs["baselines"] for one in products.read_json(path)["evaluations"]]
    rows = table([*baselines, *records])
    job.outputs["table"].write_text(to_tsv(rows, COLUMNS), encoding="utf-8")
    job.write_record({"rows": rows})
