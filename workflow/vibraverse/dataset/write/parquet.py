"""The writer of the index as Parquet, for tools that read tables of millions of rows: the same rows with types."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from vibraverse.dataset.schema.columns import Column, Table, Texts
from vibraverse.dataset.schema.tables import Columns

_TYPES = {str: pa.string(), float: pa.float64(), int: pa.int64()}


def write_parquet(path: str | Path, table: Table, columns: Columns) -> None:
    """Write a table with the meanings of its columns as metadata; the same rows give the same bytes."""
    fields = [
        pa.field(name, _TYPES[kind], metadata={"description": text}) for name, (kind, text) in columns.items()
    ]
    values = [_array(table.column(name)) for name in columns]
    pq.write_table(pa.Table.from_arrays(values, schema=pa.schema(fields)), path, compression="zstd")


def _array(column: Column) -> pa.Array:
    if isinstance(column, Texts):
        values = pa.array(column.values, pa.string())
        return pa.DictionaryArray.from_arrays(pa.array(column.codes), values).cast(pa.string())
    return pa.array(column)
