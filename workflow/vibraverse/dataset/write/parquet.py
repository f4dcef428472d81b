"""The index as Parquet, for tools that read tables of millions of rows: the same rows, typed and explained."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from vibraverse.dataset.schema.tables import Columns

_TYPES = {str: pa.string(), float: pa.float64(), int: pa.int64()}


def write_parquet(path: str | Path, rows: list[dict], columns: Columns) -> None:
    """Write rows as a table whose columns' meanings stand in their metadata; the same rows give the same bytes."""
    fields = [
        pa.field(name, _TYPES[kind], metadata={"description": text}) for name, (kind, text) in columns.items()
    ]
    values = [
        pa.array([kind(row[name]) for row in rows], _TYPES[kind]) for name, (kind, _) in columns.items()
    ]
    pq.write_table(pa.Table.from_arrays(values, schema=pa.schema(fields)), path, compression="zstd")
