"""The items of a reader: row numbers of the index, and for sampled materials the row of their body."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from vibraverse.contract.texts import unknown
from vibraverse.dataset import schema
from vibraverse.dataset.read.sampled import OWN
from vibraverse.dataset.schema.columns import Column, Table, Texts
from vibraverse.physics.materials import sampled_name

#: Types of a condition's value that stand for one value, not several.
_SINGLE = (str, int, float, np.generic)


class Items(Sequence):
    """A sequence of rows of the index; each item becomes a dictionary on access.

    ``rows`` are row numbers, None for all. ``samples`` is the number of each item's sampled material within its body,
    -1 for a named material; None if all are named. ``own`` reads the columns in which sampled materials differ: it
    takes object and solidity, and returns a column for each name of :data:`~vibraverse.dataset.read.sampled.OWN`.
    """

    def __init__(
        self,
        table: Table,
        own: Callable[[str, str], dict[str, np.ndarray]],
        rows: np.ndarray | None = None,
        samples: np.ndarray | None = None,
    ):
        self._table, self._own = table, own
        self.rows, self.samples = rows, samples

    def __len__(self) -> int:
        return len(self._table) if self.rows is None else len(self.rows)

    def __getitem__(self, index):
        if isinstance(index, slice):
            return [self[number] for number in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(f"there is no item {index} among {len(self)}")
        item = self._table.row(self._row(index))
        sample = self._sample(index)
        if sample < 0:
            return item
        own = self._own(item["object"], item["solidity"])
        values = {name: own[name][sample].item() for name in OWN}
        return {**item, "material": sampled_name(sample), **values}

    def __iter__(self) -> Iterator[dict]:
        if self.samples is None:
            return self._table.rows(self.rows)
        return (self[number] for number in range(len(self)))

    def place(self, index: int) -> dict[str, str]:
        """Return object, solidity and material of an item, without reading other columns of the index."""
        row, sample = self._row(index), self._sample(index)
        found = {name: self._table.column(name).item(row) for name in ("object", "solidity", "material")}
        return found if sample < 0 else {**found, "material": sampled_name(sample)}

    def column(self, name: str) -> Column:
        """Return a column of the items: an array of numbers, or :class:`~vibraverse.dataset.schema.columns.Texts`.

        Raises :class:`KeyError` for an unknown column.
        """
        if name not in schema.INDEX_COLUMNS:
            raise KeyError(unknown("column", name, schema.INDEX_COLUMNS))
        column = self._table.column(name)
        column = column if self.rows is None else column[self.rows]
        if self.samples is None or (name != "material" and name not in OWN):
            return column
        sampled = np.flatnonzero(self.samples >= 0)
        if name == "material":
            texts = column.tolist()
            for number in sampled.tolist():
                texts[number] = sampled_name(int(self.samples[number]))
            return Texts.of(texts)
        column = column.copy()
        for number in sampled.tolist():
            place = self.place(number)
            column[number] = self._own(place["object"], place["solidity"])[name][self.samples[number]]
        return column

    def values(self, name: str) -> list:
        """Return the distinct values of a column: texts in the order of the items, numbers ascending."""
        column = self.column(name)
        return column.present() if isinstance(column, Texts) else np.unique(column).tolist()

    def firsts(self, *names: str) -> np.ndarray:
        """Return the position of the first item with each value, or combination of values, of text columns."""
        codes = self._codes(*names)
        return np.sort(np.unique(codes, return_index=True)[1])

    def where(self, conditions: dict) -> Items:
        """Return the items whose columns have the given values (one value, or a collection)."""
        chosen = np.ones(len(self), dtype=bool)
        for name, value in conditions.items():
            allowed = {value} if isinstance(value, _SINGLE) else set(value)
            column = self.column(name)
            if isinstance(column, Texts):
                chosen &= column.among(allowed)
            else:
                numbers = [one for one in allowed if isinstance(one, (int, float, np.number))]
                chosen &= np.isin(column, numbers)
        return self.part(np.flatnonzero(chosen))

    def part(self, positions: np.ndarray) -> Items:
        """Return the items at these positions."""
        rows = positions if self.rows is None else self.rows[positions]
        samples = None if self.samples is None else self.samples[positions]
        return Items(self._table, self._own, rows.astype(_type(len(self._table))), samples)

    def with_sampled(self) -> Items:
        """Return the named items, and after those of each body its sampled materials."""
        named = self if self.samples is None else self.part(np.flatnonzero(self.samples < 0))
        if not len(named):
            return named
        _, first, body = np.unique(named._codes("object", "solidity"), return_index=True, return_inverse=True)
        place = np.argsort(np.argsort(first))[body]  # bodies in the order of their first items
        counts = named.column("sampled")[first]
        sampled = np.repeat(np.arange(len(first)), counts)
        number = np.arange(len(sampled)) - np.repeat(np.cumsum(counts) - counts, counts)
        positions = np.concatenate([np.arange(len(named)), first[sampled]])
        samples = np.concatenate([np.full(len(named), -1), number])
        order = np.argsort(np.concatenate([place, np.argsort(np.argsort(first))[sampled]]), kind="stable")
        found = named.part(positions[order])
        found.samples = samples[order].astype(np.int32)
        return found

    def _codes(self, *names: str) -> np.ndarray:
        """Return numbers (n,) that are equal where the texts of all these columns are."""
        codes = np.zeros(len(self), dtype=np.int64)
        for name in names:
            column = self.column(name)
            codes = codes * len(column.values) + column.codes
        return codes

    def _row(self, index: int) -> int:
        return index if self.rows is None else int(self.rows[index])

    def _sample(self, index: int) -> int:
        return -1 if self.samples is None else int(self.samples[index])


def _type(count: int) -> type:
    return np.int32 if count < 2**31 else np.int64
