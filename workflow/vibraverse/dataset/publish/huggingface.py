"""Exports of a reader's items for Hugging Face ``datasets``: Parquet whose sounds play and whose pictures show.

The metadata of the schema hold the features, as ``datasets`` itself writes them. A sound is a WAV file, a picture a PNG
file within the row, so both are found from any working folder and after an upload.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vibraverse.contract.products import whole
from vibraverse.dataset.publish.export import CannotExport, about, by_split, look_of, parts, pngs, wav
from vibraverse.dataset.read.reader import Reader

#: Rows that are written together, which bounds the memory that they take.
_GROUP = 100
#: Bytes of different pictures of a group that are each stored once; the pictures of an object recur in all its items.
_SHARED_BYTES = 64 * 2**20
#: Types of texts and numbers, as ``datasets`` names them.
_DTYPES = {str: "string", bool: "bool", int: "int64", float: "float64", dict: "string"}


def huggingface(
    reader: Reader, folder: Path, most_bytes: int, say: Callable[[str], None] = print
) -> list[Path]:
    """Write ``data/{split}-00000.parquet``, …, a row per item; return the files written.

    A new file begins before the rows of one would exceed ``most_bytes``. Raises :class:`CannotExport` without pyarrow.
    """
    try:
        import pyarrow.parquet as pq
    except ModuleNotFoundError:
        raise CannotExport(
            "Parquet needs pyarrow, which this environment lacks; run `pip install pyarrow`"
        ) from None
    written, schema = [], None
    for split, items in by_split(reader).items():
        for number, part in enumerate(parts(_rows(reader, items), _size, most_bytes)):
            schema = schema or _schema(part[0], reader.fields)
            path = folder / f"data/{split}-{number:05d}.parquet"
            with (
                whole(path) as partial,
                pq.ParquetWriter(
                    partial,
                    schema,
                    compression="zstd",
                    use_dictionary=_recurring(schema),
                    dictionary_pagesize_limit=_SHARED_BYTES,
                ) as table,
            ):
                for first in range(0, len(part), _GROUP):
                    table.write_table(_table(part[first : first + _GROUP], schema))
            written.append(path)
            say(f"data/{path.name}: {len(part)} items")
    return written


def _rows(reader: Reader, items):
    """Yield the rows of items; those of an object share its pictures."""
    shown, pictures = None, None
    for item in items:
        plain, arrays = about(reader, item)
        row = plain | arrays
        if "sound" in reader.fields:
            sound = wav(reader, item)
            name = f"{item['object']}-{item['solidity']}-{item['material']}.wav"
            row["sound"] = None if sound is None else {"bytes": sound, "path": name}
        if "views" in reader.fields:
            wanted = item["object"], look_of(reader, item)
            if wanted != shown:
                shown = wanted
                pictures = [
                    {"bytes": file, "path": f"{'-'.join(shown)}-{view:02d}.png"}
                    for view, file in enumerate(pngs(reader, *shown))
                ]
            row["views"] = pictures
        yield row


def _size(row: dict, before: dict | None) -> int:
    """Return the bytes of a row; pictures that it shares with the one before add none."""
    total = 0
    for name, value in row.items():
        if isinstance(value, np.ndarray):
            total += value.nbytes
        elif name == "sound":
            total += len(value["bytes"]) if value else 0
        elif name == "views":
            shared = before is not None and before["views"] is value
            total += 0 if shared else sum(len(one["bytes"]) for one in value)
        else:
            total += len(str(value))
    return total


def _schema(row: dict, fields):
    """Return the schema of rows like this one, with the features of ``datasets`` in its metadata."""
    import pyarrow as pa

    columns, features = [], {}
    file = pa.struct({"bytes": pa.binary(), "path": pa.string()})
    for name, value in row.items():
        if name in fields and name == "sound":
            kind, feature = file, {"_type": "Audio"}
        elif name in fields and name == "views":
            # A list in brackets is read by every version; ``List`` and ``Sequence`` are not.
            kind, feature = pa.list_(file), [{"_type": "Image"}]
        elif isinstance(value, np.ndarray):
            kind, feature = pa.from_numpy_dtype(value.dtype), {"_type": "Value", "dtype": value.dtype.name}
            for _ in range(value.ndim):
                kind, feature = pa.list_(kind), [feature]
        else:
            dtype = _DTYPES[type(value)]
            kind, feature = pa.type_for_alias(dtype), {"_type": "Value", "dtype": dtype}
        columns.append(pa.field(name, kind))
        features[name] = feature
    return pa.schema(columns, metadata={"huggingface": json.dumps({"info": {"features": features}})})


def _recurring(schema) -> list[str]:
    """Return the columns whose values recur: texts and pictures."""
    import pyarrow as pa

    texts = [field.name for field in schema if field.type == pa.string()]
    return texts + [f"views.list.element.{part}" for part in ("bytes", "path")]


def _table(rows: list[dict], schema):
    import pyarrow as pa

    columns = []
    for field in schema:
        values = [row[field.name] for row in rows]
        if isinstance(values[0], np.ndarray):
            columns.append(_nested(values))
        elif any(isinstance(value, dict) for value in values) and field.type == pa.string():
            columns.append(pa.array([json.dumps(value, ensure_ascii=False) for value in values]))
        else:
            columns.append(pa.array(values, field.type))
    return pa.Table.from_arrays(columns, schema=schema)


def _nested(arrays: list[np.ndarray]):
    """Return arrays of equal rank as lists of lists, without a Python object for each number."""
    import pyarrow as pa

    column = pa.array(np.concatenate([one.ravel() for one in arrays]))
    for axis in reversed(range(arrays[0].ndim)):
        lengths = [np.full(int(np.prod(one.shape[:axis])), one.shape[axis]) for one in arrays]
        offsets = np.concatenate([[0], np.cumsum(np.concatenate(lengths))])
        column = pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), column)
    return column
