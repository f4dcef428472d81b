"""A columnar table in a group of an HDF5 file, for NumPy and h5py; ``index.h5`` consists of them.

A number column is an array. A text column is an array of codes; ``values/{column}`` holds their texts.
"""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path

import numpy as np

from vibraverse.dataset.schema.columns import Column, Table, Texts
from vibraverse.dataset.schema.tables import Columns

#: Group of the distinct texts, beside the columns.
_VALUES = "values"
#: Rows in a chunk, and its compression, which pays because the rows of an object repeat each other.
_CHUNK_ROWS, _GZIP_LEVEL = 65_536, 4
#: Columns of fewer bytes than this are not compressed.
_MIN_COMPRESSED_BYTES = 4096


def write_table(group, table: Table, columns: Columns) -> None:
    """Write a table into an empty HDF5 group; the same rows give the same bytes."""
    import h5py

    for name, (_, meaning) in columns.items():
        column = table.column(name)
        if isinstance(column, Texts):
            column = column.compact()
            text = h5py.string_dtype("utf-8")
            group.create_dataset(f"{_VALUES}/{name}", data=np.array(column.values, dtype=object), dtype=text)
            column = column.codes
        packed = {}
        if column.nbytes >= _MIN_COMPRESSED_BYTES:
            chunk = (min(len(column), _CHUNK_ROWS),)
            packed = {
                "chunks": chunk,
                "shuffle": True,
                "compression": "gzip",
                "compression_opts": _GZIP_LEVEL,
            }
        group.create_dataset(name, data=column, **packed).attrs["description"] = meaning


class StoredTable(Table):
    """A table in a group of an HDF5 file; its columns are read on first use.

    No handle stays open. Raises :class:`OSError` if the file was replaced in the meantime.
    """

    def __init__(self, path: Path, group: str, columns: Columns):
        super().__init__({}, 0)
        self._path, self._group, self._names = path, group, tuple(columns)
        self._version = version_of(path)

    def __len__(self) -> int:
        return self._rows

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the columns."""
        return self._names

    def column(self, name: str) -> Column:
        """Return a column by name, from the file on first use."""
        if name not in self._columns:
            self._columns[name] = self._read(name)
        return self._columns[name]

    @cached_property
    def _rows(self) -> int:
        import h5py

        with h5py.File(self._path) as h5:
            return len(h5[self._group][self._names[0]])

    def _read(self, name: str) -> Column:
        import h5py

        if name not in self._names:
            raise KeyError(name)
        with h5py.File(self._path) as h5:
            if version_of(self._path) != self._version:
                raise OSError(f"{self._path} was written anew since it was opened; open the dataset again")
            group = h5[self._group]
            column = group[name][()]
            values = group.get(f"{_VALUES}/{name}")
            return column if values is None else Texts(column, values.asstr()[()])


def version_of(path: Path) -> tuple[int, int, int]:
    """Return values that differ between a file and one that replaces it."""
    about = os.stat(path)
    return about.st_ino, about.st_size, about.st_mtime_ns
