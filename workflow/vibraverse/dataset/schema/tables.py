"""Tab-separated tables with typed columns: the index and the refusals.

A text that contains a double quote is quoted as in CSV, so any CSV reader with tab as its separator reads them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator

from vibraverse.contract.texts import storable

Columns = dict[str, tuple[type, str]]


def to_tsv(rows: Iterable[dict], columns: Columns) -> str:
    """Return a header and one line per row; white space inside a text becomes one space.

    Numbers keep every digit, so the round trip through :func:`from_tsv` is exact.
    """
    cells = ([_cell(row[name], kind) for name, (kind, _) in columns.items()] for row in rows)
    return lines_of([columns, *cells])


def from_tsv(text: str, columns: Columns) -> list[dict]:
    """Return the rows of a table, each value in the type of its column.

    Raises :class:`ValueError` if the header differs from the columns, or a row does not fit them.
    """
    kinds = [kind for kind, _ in columns.values()]
    return [
        {name: kind(cell) for name, kind, cell in zip(columns, kinds, row, strict=True)}
        for row in read_cells(text, columns)
    ]


def lines_of(rows: Iterable[Iterable[str]]) -> str:
    """Return rows of cells as lines."""
    text = io.StringIO()
    csv.writer(text, delimiter="\t", lineterminator="\n").writerows(rows)
    return text.getvalue()


def to_cells(values: Iterable, kind: type) -> list[str]:
    """Return the values of one column as cells."""
    return [_cell(value, kind) for value in values]


def read_cells(text: str, columns: Columns) -> Iterator[list[str]]:
    """Yield the cells of each row of a table after its header; raise the errors of :func:`from_tsv`."""
    lines = csv.reader(io.StringIO(text, newline=""), delimiter="\t")
    try:
        header = next(lines, [])
        if header != list(columns):
            raise ValueError(f"the table's columns are {header}, not {list(columns)}")
        yield from lines
    except csv.Error as error:
        raise ValueError(f"it is no table ({error})") from None


def _cell(value, kind: type) -> str:
    return " ".join(storable(str(value)).split()) if kind is str else repr(kind(value))
