"""Columnar tables: a number column is an array, a text column is codes into its distinct values.

In an index of 800,000 rows, a column takes 1 to 8 bytes per row; the same rows as dictionaries take a gigabyte.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

import numpy as np

from vibraverse.dataset.schema.tables import Columns, lines_of, read_cells, to_cells

#: Rows that are converted to Python objects at a time.
_BLOCK_ROWS = 8192


class Texts:
    """A column of texts: ``codes`` (n,) of unsigned integers, each the position of its text in ``values``."""

    def __init__(self, codes: np.ndarray, values: Sequence[str]):
        self.codes, self.values = codes, list(values)

    @classmethod
    def of(cls, texts: Iterable[str]) -> Texts:
        """Return texts as a column; values are in the order of first appearance."""
        known: dict[str, int] = {}
        codes = [known.setdefault(text, len(known)) for text in texts]
        return cls(_small(np.array(codes, dtype=np.int64), len(known)), list(known))

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, rows) -> Texts:
        """Return the column at an array or a slice of row numbers."""
        return Texts(self.codes[rows], self.values)

    def item(self, row: int) -> str:
        """Return the text of one row."""
        return self.values[self.codes[row]]

    def tolist(self) -> list[str]:
        """Return all texts; equal ones are the same object."""
        return [self.values[code] for code in self.codes.tolist()]

    def present(self) -> list[str]:
        """Return the distinct texts that occur, in the order of the rows."""
        return self.compact().values

    def compact(self) -> Texts:
        """Return the same column with only the values that occur, in the order of the rows."""
        codes, first, inverse = np.unique(self.codes, return_index=True, return_inverse=True)
        order = np.argsort(first)
        places = np.empty(len(order), dtype=np.int64)
        places[order] = np.arange(len(order))
        return Texts(
            _small(places[inverse], len(order)), [self.values[code] for code in codes[order].tolist()]
        )

    def ranks(self) -> np.ndarray:
        """Return numbers (n,) that sort like the texts."""
        order = sorted(range(len(self.values)), key=self.values.__getitem__)
        ranks = np.empty(len(order), dtype=np.int64)
        ranks[order] = np.arange(len(order))
        return ranks[self.codes]

    def among(self, allowed: set) -> np.ndarray:
        """Return the mask (n,) of the rows that hold one of these texts."""
        return np.array([value in allowed for value in self.values], dtype=bool)[self.codes]


Column = Texts | np.ndarray


class Table:
    """Rows of one kind, by column. :meth:`column` gives a whole column, :meth:`row` one row as a dictionary."""

    def __init__(self, columns: dict[str, Column], count: int):
        self._columns, self._count = columns, count

    @classmethod
    def from_tsv(cls, text: str, columns: Columns) -> Table:
        """Return the rows of a tab-separated table; raise the errors of :func:`~.tables.from_tsv`.

        Rows are converted in blocks, so that few of them are Python objects at a time.
        """
        cells, parts = read_cells(text, columns), []
        while rows := list(islice(cells, _BLOCK_ROWS)):
            by_column = zip(columns.items(), zip(*rows, strict=True), strict=True)
            found = {name: _column(kind, list(map(kind, values))) for (name, (kind, _)), values in by_column}
            parts.append(cls(found, len(rows)))
        return joined(parts, columns)

    def __len__(self) -> int:
        return self._count

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self._columns)

    def column(self, name: str) -> Column:
        """Return a column by name."""
        return self._columns[name]

    def take(self, rows) -> Table:
        """Return the table of these rows (an array of row numbers, or a mask)."""
        taken = {name: self.column(name)[rows] for name in self.names}
        return Table(taken, len(next(iter(taken.values()))))

    def sorted_by(self, name: str) -> Table:
        """Return the rows sorted by a text column; the sort is stable."""
        return self.take(np.argsort(self.column(name).ranks(), kind="stable"))

    def with_columns(self, columns: Columns, **changes: Column) -> Table:
        """Return the table with these columns replaced or added, in the order of ``columns``."""
        return Table(
            {name: changes[name] if name in changes else self.column(name) for name in columns}, len(self)
        )

    def row(self, number: int) -> dict:
        """Return one row as a dictionary of texts and numbers."""
        return {name: self.column(name).item(number) for name in self.names}

    def rows(self, numbers: np.ndarray | None = None) -> Iterator[dict]:
        """Yield rows as dictionaries: all of them, or those with these numbers."""
        count = len(self) if numbers is None else len(numbers)
        for start in range(0, count, _BLOCK_ROWS):
            part = slice(start, min(start + _BLOCK_ROWS, count))
            rows = part if numbers is None else numbers[part]
            lists = [self.column(name)[rows].tolist() for name in self.names]
            yield from (dict(zip(self.names, values, strict=True)) for values in zip(*lists, strict=True))

    def tsv(self, columns: Columns) -> Iterator[str]:
        """Yield the text of :func:`~.tables.to_tsv` in pieces."""
        yield lines_of([columns])
        ready = {}
        for name, (kind, _) in columns.items():
            column = self.column(name)
            ready[name] = Texts(column.codes, to_cells(column.values, kind)) if kind is str else column
        for start in range(0, len(self), _BLOCK_ROWS):
            cells = [
                column[start : start + _BLOCK_ROWS].tolist()
                if isinstance(column, Texts)
                else to_cells(column[start : start + _BLOCK_ROWS].tolist(), columns[name][0])
                for name, column in ready.items()
            ]
            yield lines_of(zip(*cells, strict=True))


def joined(tables: Sequence[Table], columns: Columns) -> Table:
    """Return the rows of several tables, one after the other."""
    found = {}
    for name, (kind, _) in columns.items():
        parts = [table.column(name) for table in tables]
        found[name] = _texts(parts) if kind is str else np.concatenate([_column(kind, []), *parts])
    return Table(found, sum(map(len, tables)))


def _texts(parts: Sequence[Texts]) -> Texts:
    known: dict[str, int] = {}
    codes = []
    for part in parts:
        places = np.array([known.setdefault(value, len(known)) for value in part.values], dtype=np.int64)
        codes.append(_small(places[part.codes] if len(part) else places[:0], len(known)))
    return Texts(_small(np.concatenate([np.empty(0, np.uint8), *codes]), len(known)), list(known))


def _column(kind: type, values: list) -> Column:
    if kind is str:
        return Texts.of(values)
    return np.array(values, dtype=np.float64 if kind is float else np.int64)


def _small(codes: np.ndarray, count: int) -> np.ndarray:
    return codes.astype(np.min_scalar_type(max(count - 1, 0)))
