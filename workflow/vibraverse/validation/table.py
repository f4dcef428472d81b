"""The table of all comparisons, the orders of convergence, and the tolerances missed."""

from __future__ import annotations

import numpy as np

#: Column -> type and meaning.
COLUMNS: dict[str, tuple[type, str]] = {
    "body": (str, "name of the body"),
    "mode": (str, "multiplet of a ball, or numbers of the elastic modes"),
    "equal": (int, "number of equal frequencies; the worst is shown"),
    "poisson": (float, "Poisson's ratio"),
    "reference_hz": (float, "reference frequency"),
    "computed_hz": (float, "computed frequency"),
    "relative_error": (float, "computed over reference, minus 1"),
    "order": (int, "order of the elements"),
    "corrected": (str, "yes if the discretisation error was estimated and removed"),
    "tetrahedra": (int, "elements of the mesh"),
    "unknowns": (int, "unknowns of the eigenproblem"),
    "tolerance": (float, "largest error accepted; nan if only shown"),
    "verdict": (str, "met, missed, or shown"),
    "source": (str, "source of the reference"),
}


def tsv_rows(rows: list[dict]) -> list[dict]:
    """Return rows for :func:`vibraverse.dataset.schema.tables.to_tsv`, with NaN for a missing tolerance."""
    return [{**row, "tolerance": np.nan if row["tolerance"] is None else row["tolerance"]} for row in rows]


def elements(row: dict) -> str:
    """Return the name of the elements of a row or a summary: ``P2 corrected``."""
    return f"P{row['order']}" + (" corrected" if row["corrected"] == "yes" else "")


def convergence(rows: list[dict]) -> dict[str, dict]:
    """Return unknowns, errors and the slope of convergence for each kind of elements in one body's rows.

    The error of a mesh is the root mean square over all computed references. In theory the error of a frequency is
    proportional to the element size to the power of twice the order, that is, unknowns to the power -2/3 or -4/3.
    """
    found: dict[str, dict] = {}
    for kind in dict.fromkeys(elements(row) for row in rows):
        some = [row for row in rows if elements(row) == kind and not row["published"]]
        unknowns = sorted({row["unknowns"] for row in some})
        errors = [
            float(np.sqrt(np.mean([row["relative_error"] ** 2 for row in some if row["unknowns"] == n])))
            for n in unknowns
        ]
        slope = float(np.polyfit(np.log(unknowns), np.log(errors), 1)[0]) if len(unknowns) > 1 else None
        found[kind] = {"unknowns": unknowns, "errors": errors, "slope": slope}
    return found


def summary(rows: list[dict]) -> list[dict]:
    """Return the judged rows of one body and the worst of them, for each kind of elements and each source."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        if row["tolerance"] is not None:
            groups.setdefault((elements(row), row["source"]), []).append(row)
    return [
        {
            "elements": kind,
            "source": source,
            "unknowns": some[0]["unknowns"],
            "frequencies": sum(row["equal"] for row in some),
            "largest_error": max(abs(row["relative_error"]) for row in some),
            "tolerance": min(row["tolerance"] for row in some),
            "missed": sum(row["verdict"] == "missed" for row in some),
        }
        for (kind, source), some in groups.items()
    ]


def missed(rows: list[dict]) -> list[str]:
    """Return a sentence for every missed tolerance."""
    return [
        f"{row['body']}, mode {row['mode']}, Poisson's ratio {row['poisson']:.3g}, {elements(row)}: "
        f"{row['computed_hz']:,.2f} Hz instead of {row['reference_hz']:,.2f} Hz is off by "
        f"{100 * abs(row['relative_error']):.3g} %, and {100 * row['tolerance']:.3g} % is accepted ({row['source']})."
        for row in rows
        if row["verdict"] == "missed"
    ]
