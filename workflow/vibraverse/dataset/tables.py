"""Tab-separated tables with typed columns: the index and the refusals."""

from __future__ import annotations

Columns = dict[str, tuple[type, str]]


def to_tsv(rows: list[dict], columns: Columns) -> str:
    """Return a header and one line per row; white space inside a text becomes one blank.

    Numbers keep every digit: what :func:`from_tsv` reads is what was written.
    """
    lines = ["\t".join(columns)]
    for row in rows:
        lines.append("\t".join(_cell(row[name], kind) for name, (kind, _) in columns.items()))
    return "\n".join(lines) + "\n"


def from_tsv(text: str, columns: Columns) -> list[dict]:
    """Return the rows of a table, each value as its column's type.

    Raises :class:`ValueError` when the header is not the columns'.
    """
    header, *lines = text.splitlines()
    if header.split("\t") != list(columns):
        raise ValueError(f"the table's columns are {header.split()}, not {list(columns)}")
    kinds = [kind for kind, _ in columns.values()]
    return [
        {name: kind(cell) for name, kind, cell in zip(columns, kinds, line.split("\t"), strict=True)}
        for line in lines
    ]


def _cell(value, kind: type) -> str:
    return " ".join(str(value).split()) if kind is str else repr(kind(value))
