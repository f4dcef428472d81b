"""The writer of the columnar index, ``index.h5``, from which a dataset is opened."""

from __future__ import annotations

from pathlib import Path

from vibraverse.dataset import schema
from vibraverse.dataset.read.index import TABLES, Index
from vibraverse.dataset.schema.bycolumn import write_table


def write_index(path: str | Path, index: Index) -> None:
    """Write an index; the same rows give the same bytes, whatever the order of the shards.

    It states no provenance; ``dataset.json``, which lists it, does.
    """
    import h5py

    with h5py.File(path, "w") as h5:
        h5.attrs["format"], h5.attrs["format_version"] = schema.INDEX_FORMAT, schema.FORMAT_VERSION
        for name, columns in TABLES.items():
            write_table(h5.create_group(name), index.tables[name], columns)
