"""Stage ``validation_table``: the comparisons of all bodies in, one table and a convergence plot out."""

from __future__ import annotations

from vibraverse.contract import products
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Join the comparisons of all bodies; a refused body counts as missed."""
    from vibraverse.dataset.schema.tables import to_tsv
    from vibraverse.validation import plot, table
    from vibraverse.validation.bodies import BODIES

    rows, bodies, missed = [], {}, []
    for path in job.inputs["comparisons"]:
        refusal = read_refusal(path)
        if refusal:
            missed.append(f"{refusal.object}, refused by {refusal.stage}: {refusal.message}")
            continue
        comparison = products.read_json(path)
        name, own = comparison["body"], comparison["rows"]
        bodies[name] = {
            "title": BODIES[name].title,
            "summary": table.summary(own),
            "convergence": table.convergence(own),
        }
        rows += own
        missed += table.missed(own)
    job.outputs["table"].write_text(to_tsv(table.tsv_rows(rows), table.COLUMNS), encoding="utf-8")
    job.outputs["plot"].write_text(plot.svg(bodies), encoding="utf-8")
    job.write_record({"missed": missed, "bodies": bodies, "rows": rows})
