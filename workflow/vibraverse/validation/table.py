"""The table of all comparisons, how fast errors fall, and what is missed."""

from __future__ import annotations

import numpy as np

#: Column -> type and meaning.
COLUMNS: dict[str, tuple[type, str]] = {
    "body": (str, "name of the body"),
    "mode": (str, "multiplet of a ball, or numbers of the elastic modes"),
    "equal": (int, "how many frequencies are equal to it; the one farthest off is shown"),
    "poisson": (float, "Poisson's ratio"),
    "reference_hz": (float, "what it must be"),
    "computed_hz": (float, "what it is"),
    "relative_error": (float, "computed over reference, less 1"),
    "order": (int, "order of the elements"),
    "corrected": (str, "yes where the elements' own error was estimated and taken out"),
    "tetrahedra": (int, "elements of the mesh"),
    "unknowns": (int, "unknowns of the eigenproblem"),
    "tolerance": (float, "largest error accepted; nan where it is shown only"),
    "verdict": (str, "met, missed, or shown"),
    "source": (str, "where the reference comes from"),
}


def tsv_rows(rows: list[dict]) -> list[dict]:
    """Return rows as :func:`vibraverse.dataset.schema.tables.to_tsv` takes them: NaN for a missing tolerance."""
    return [{**row, "tolerance": np.nan if row["tolerance"] is None else row["tolerance"]} for row in rows]


def elements(row: dict) -> str:
    """Return what the elements of a row or summary are called."""
    return f"P{row['order']}" + (" corrected" if row["corrected"] == "yes" else "")


def convergence(rows: list[dict]) -> dict[str, dict]:
    """Return, for each kind of elements of one body's rows, unknowns, errors and the power with which errors fall.

    The error of a mesh is the root of the mean square over all computed references. In theory a frequency's error goes
    like the element's size to twice the order, which is unknowns to the power -2/3 and -4/3.
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
    """Return how many of one body's rows are judged, and the worst of them, for each kind of elements and source."""
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
    """Return a sentence for every tolerance that is missed."""
    return [
        f"{row['body']}, mode {row['mode']}, Poisson's ratio {row['poisson']:.3g}, {elements(row)}: "
        f"{row['computed_hz']:,.2f} Hz instead of {row['reference_hz']:,.2f} Hz is off by "
        f"{100 * abs(row['relative_error']):.3g} %, and {100 * row['tolerance']:.3g} % is accepted ({row['source']})."
        for row in rows
        if row["verdict"] == "missed"
    ]
