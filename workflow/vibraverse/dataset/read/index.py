"""The index of a dataset: its rows by column, the shard of every object, and the refusals.

A dataset's folder holds it in one file, ``index.h5``, of which readers load only the columns they need. If the file
does not exist, or differs from what ``dataset.json`` states, the same index is read from the shards, more slowly.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from vibraverse.contract.products import read_json, sha256
from vibraverse.contract.readable import unreadable
from vibraverse.dataset import schema
from vibraverse.dataset.schema.bycolumn import StoredTable
from vibraverse.dataset.schema.columns import Table, Texts, joined
from vibraverse.dataset.schema.tables import from_tsv

#: Names in a dataset's folder.
_RECORD, _FILE, _SPLITS = "dataset.json", "index.h5", "splits.tsv"
#: The tables of an index, by group in ``index.h5``, with their columns.
TABLES = {
    schema.ITEMS: schema.INDEX_COLUMNS,
    schema.OBJECTS: schema.OBJECT_COLUMNS,
    schema.REFUSALS: schema.REFUSAL_COLUMNS,
}


class Index:
    """The content of a dataset: ``shards`` by name, and the tables ``items``, ``objects`` and ``refusals``.

    The index of a folder or a file (``source``) is pickled as that path and its ``identity``, and read again when
    unpickled. Any other index is pickled with its columns.
    """

    def __init__(
        self, shards: dict[str, Path], tables: dict[str, Table], identity: str, source: Path | None = None
    ):
        self.shards, self.tables, self.identity, self.source = shards, tables, identity, source

    @property
    def items(self) -> Table:
        """The rows of the index, sorted by object."""
        return self.tables[schema.ITEMS]

    @cached_property
    def refusals(self) -> list[dict]:
        """The rows of the refusals, sorted by object."""
        return list(self.tables[schema.REFUSALS].rows())

    @cached_property
    def shard_of(self) -> dict[str, str]:
        """The name of the shard of every object, refused ones included."""
        objects = self.tables[schema.OBJECTS]
        return dict(zip(objects.column("object").tolist(), objects.column("shard").tolist(), strict=True))

    def placed(self, splits: dict[str, str]) -> Index:
        """Return the index with the splits of its objects; "" for an object that ``splits`` does not name."""
        objects = self.items.column("object")
        of_each = Texts.of([splits.get(one, "") for one in objects.values])
        split = Texts(of_each.codes[objects.codes], of_each.values)
        items = self.items.with_columns(schema.INDEX_COLUMNS, split=split)
        return Index(self.shards, {**self.tables, schema.ITEMS: items}, self.identity)

    def __reduce__(self):
        if self.source is not None:
            return _again, (self.source, self.identity)
        return Index, (self.shards, self.tables, self.identity)


def index_at(path: str | Path) -> Index:
    """Return the index of a dataset's folder, of one shard, or of a view of several datasets.

    Raises :class:`FileNotFoundError` if the dataset does not exist, and the errors of :func:`of_shards`.
    """
    path = Path(path)
    index = None if path.is_file() else _stored(path)
    if index is None:
        index = of_shards(shards_at(path), splits_at(path))
    index.source = path
    return index


def of_shards(shards: Iterable[str | Path], splits: dict[str, str] | None = None) -> Index:
    """Return the index of shards, from the rows that each of them holds.

    Raises :class:`ValueError` for a file that is not a shard, or follows another version of the schema.
    """
    import h5py

    paths = {Path(path).name: Path(path) for path in shards}
    items, refusals, objects, names = [], [], [], []
    digest = hashlib.sha256(json.dumps(sorted((splits or {}).items())).encode())
    for name, path in paths.items():
        with h5py.File(path) as h5:
            strange = schema.strange(h5)
            if strange:
                raise ValueError(f"{path}: {strange}")
            rows, refused = (h5[key].asstr()[()] for key in (schema.INDEX, schema.REFUSALS))
            here = list(h5["objects"])
        items.append(Table.from_tsv(rows, schema.SHARD_COLUMNS))
        refusals.append(Table.from_tsv(refused, schema.REFUSAL_COLUMNS))
        objects += here
        names += [name] * len(here)
        digest.update(json.dumps([name, rows, refused, here]).encode())
    tables = {
        schema.ITEMS: joined(items, schema.SHARD_COLUMNS),
        schema.OBJECTS: Table({"object": Texts.of(objects), "shard": Texts.of(names)}, len(objects)),
        schema.REFUSALS: joined(refusals, schema.REFUSAL_COLUMNS),
    }
    tables = {name: table.sorted_by("object") for name, table in tables.items()}
    return Index(paths, tables, digest.hexdigest()).placed(splits or {})


def read_index(file: str | Path, shards: Iterable[str | Path], identity: str = "") -> Index:
    """Return the index of shards from an ``index.h5``, wherever they are; raise :class:`ValueError` if it is none."""
    import h5py

    file = Path(file)
    with h5py.File(file) as h5:
        found = h5.attrs.get("format"), int(h5.attrs.get("format_version", 0))
    if found != (schema.INDEX_FORMAT, schema.FORMAT_VERSION):
        raise ValueError(f"{file} is no index of version {schema.FORMAT_VERSION} of the schema")
    tables = {name: StoredTable(file, name, columns) for name, columns in TABLES.items()}
    return Index({Path(path).name: Path(path) for path in shards}, tables, identity)


def _stored(folder: Path) -> Index | None:
    """Return the index in a dataset's ``index.h5``; None if ``dataset.json`` does not confirm it.

    It confirms the size and the checksum of the file, the checksum of the splits, the number of rows, and the size of
    every shard.
    """
    file, shards = folder / _FILE, shards_at(folder)
    try:
        record = read_json(folder / _RECORD)
        stated, rows = record["files"][_FILE], record["counts"]["items"]
        sizes = {shard: record["shards"][shard.name]["bytes"] for shard in shards}
        splits = record["files"][_SPLITS]["sha256"]
        if any(path.stat().st_size != size for path, size in {**sizes, file: stated["bytes"]}.items()):
            return None
        if sha256(folder / _SPLITS) != splits or sha256(file) != stated["sha256"]:
            return None
        index = read_index(file, shards, stated["sha256"])
    except (LookupError, TypeError, ValueError, OSError):  # an older dataset, or one that is being written
        return None
    return index if len(index.items) == rows else None


def _again(source: Path, identity: str) -> Index:
    """Return the index of a path, read again after unpickling."""
    index = index_at(source)
    if index.identity != identity:
        raise OSError(f"{source} was written anew since it was opened; open the dataset again")
    return index


def shards_at(path: str | Path) -> list[Path]:
    """Return the shards at a path: a shard itself, or those that ``dataset.json`` in a dataset's folder lists.

    Raises :class:`FileNotFoundError` if the dataset does not exist.
    """
    path = Path(path)
    if path.is_file():
        return [path]
    record = path / _RECORD
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; name a dataset's folder, or a shard")
    if wrong := unreadable(record):
        raise FileNotFoundError(f"{path} holds no finished dataset: {record} {wrong}")
    return [path / "shards" / name for name in read_json(record)["shards"]]


def splits_at(path: str | Path) -> dict[str, str]:
    """Return the split of every object from ``splits.tsv`` in a dataset's folder; for a shard, from its dataset's.

    A view of several datasets holds its own splits. Empty without splits.
    """
    path = Path(path)
    if path.is_file():
        import h5py

        with h5py.File(path) as h5:
            if schema.SPLITS in h5:
                return _splits_in(h5[schema.SPLITS].asstr()[()])
    table = (path.parent.parent if path.is_file() else path) / _SPLITS
    return read_splits(table) if table.is_file() else {}


def read_splits(table: str | Path) -> dict[str, str]:
    """Return the split of every object from a ``splits.tsv``."""
    return _splits_in(Path(table).read_text(encoding="utf-8"))


def _splits_in(text: str) -> dict[str, str]:
    return {row["object"]: row["split"] for row in from_tsv(text, schema.SPLIT_COLUMNS)}
