"""Reading a dataset with NumPy alone.

Handles open late and in each process anew, so a reader may be handed to data-loader workers: each opens its own.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from vibraverse.contract.readable import unreadable
from vibraverse.contract.texts import unknown
from vibraverse.dataset import schema
from vibraverse.dataset.read.sampled import read_sampled, rows_of
from vibraverse.dataset.read.shapes import Shapes
from vibraverse.dataset.schema import SPLIT_COLUMNS
from vibraverse.dataset.schema.tables import from_tsv
from vibraverse.physics.materials import sampled_number

#: What a sample holds unless asked otherwise: what every task needs, small, and of one shape for all bodies.
DEFAULT_FIELDS = ("frequencies_hz", "damping_per_s", "size_m", "density_kg_m3", "young_pa", "poisson")

#: Shards that a process keeps open: a system allows some 1,000 files, and a worker is not alone.
_MOST_OPEN = 64


class Reader:
    """A dataset, or a part of it.

    ``shards`` are the HDF5 files. ``len(reader)`` counts its items, one per object, solidity and material, and
    ``reader.items[i]`` is the row of the index; ``splits`` says in which split each object is. :meth:`sample` reads
    the chosen ``fields`` of an item, :meth:`read` one field of any object, :meth:`where` narrows the items and
    :meth:`with_sampled` adds the sampled materials.
    """

    def __init__(
        self,
        shards: Iterable[str | Path],
        fields: Sequence[str] = DEFAULT_FIELDS,
        look: str = "clay",
        splits: dict[str, str] | None = None,
    ):
        self.shards = {Path(path).name: Path(path) for path in shards}
        self.fields = tuple(fields)
        self.look = look
        for name in self.fields:
            _field(name)
        self._handles: dict[str, object] = {}
        self._shapes = Shapes()
        self._process = os.getpid()
        self.items: list[dict] = []
        self.refusals: list[dict] = []
        self._shard_of: dict[str, str] = {}
        for name in self.shards:
            self._read_tables(name)
        self.items.sort(key=lambda row: row["object"])
        self.place(splits or {})
        self.refusals.sort(key=lambda row: row["object"])

    def _read_tables(self, shard: str) -> None:
        import h5py

        with h5py.File(self.shards[shard]) as h5:
            strange = schema.strange(h5)
            if strange:
                raise ValueError(f"{self.shards[shard]}: {strange}")
            self.items += from_tsv(h5[schema.INDEX].asstr()[()], schema.SHARD_COLUMNS)
            self.refusals += from_tsv(h5[schema.REFUSALS].asstr()[()], schema.REFUSAL_COLUMNS)
            self._shard_of.update(dict.fromkeys(h5["objects"], shard))

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> dict:
        return self.sample(self.items[index])

    def __iter__(self):
        return (self.sample(item) for item in self.items)

    @property
    def objects(self) -> list[str]:
        """Ids of the objects among the items, each once, sorted."""
        return list(dict.fromkeys(item["object"] for item in self.items))

    def where(self, **conditions) -> Reader:
        """Return a reader of the items whose columns have the given values (a value, or a collection of them).

        ``reader.where(split="train", material=["steel", "wood"])``. Raises :class:`KeyError` for an unknown column.
        """
        for name in conditions:
            if name not in schema.INDEX_COLUMNS:
                raise KeyError(unknown("column", name, schema.INDEX_COLUMNS))
        if "split" in conditions and not all(row["split"] for row in self.items):
            raise KeyError(
                "a shard alone knows no splits, which depend on all objects: open the dataset's folder"
            )
        allowed = {
            name: {value} if isinstance(value, (str, int, float)) else set(value)
            for name, value in conditions.items()
        }
        return self._part([row for row in self.items if all(row[name] in allowed[name] for name in allowed)])

    def _part(self, items: list[dict]) -> Reader:
        """Return a reader of the same shards with other items."""
        part = object.__new__(Reader)
        part.__dict__.update(self.__dict__)
        part.items = items
        return part

    def place(self, splits: dict[str, str]) -> None:
        """Say in which split each object is: "" where ``splits`` does not."""
        self.items = [
            {
                name: splits.get(row["object"], "") if name == "split" else row[name]
                for name in schema.INDEX_COLUMNS
            }
            for row in self.items
        ]

    def with_sampled(self) -> Reader:
        """Return a reader whose items are these and, after those of each body, its sampled materials."""
        bodies: dict[tuple, list[dict]] = {}
        for row in self.items:
            bodies.setdefault((row["object"], row["solidity"]), []).append(row)
        items = []
        for (object_id, solidity), rows in bodies.items():
            items += rows
            if rows[0]["sampled"]:
                items += rows_of(self.group(object_id)[solidity], rows[0])
        return self._part(items)

    def sample(self, item: dict) -> dict:
        """Return the chosen fields of an item, under their names, with ``object``, ``solidity`` and ``material``."""
        place = {name: item[name] for name in ("object", "solidity", "material")}
        return {**place, **{name: self.read(name, **place) for name in self.fields}}

    def read(self, field: str, object: str, solidity: str = "solid", material: str = "", **wildcards):
        """Return one field of one object: an array, a number, a text, a record (dict).

        ``views`` come decoded, (views, height, width, 3) uint8, in the reader's ``look`` (the look ``"material"``
        means that of the material) or in ``look=…``; ``sound`` is the material's, or ``sound=…``.
        Raises :class:`KeyError` when the dataset does not hold it; of what was refused, it says where and why.
        """
        spec = _field(field)
        look = self.look if self.look != "material" else material
        names = {"solidity": solidity, "material": material, "look": look, "sound": material, **wildcards}
        path = spec.path.format(**names)
        group = self.group(object)
        number = sampled_number(material)
        try:
            if number is not None and "{material}" in spec.path:
                return read_sampled(group[solidity], field, number)
            if field == "mode_shapes":
                return self._shapes.read(group[solidity], (object, solidity), material)
            value = group[path.split("@")[0] or "."]
            value = value.attrs[spec.path.split("@")[1]] if spec.is_attribute else value
        except KeyError:
            refused = self._refused(object, solidity if "{solidity}" in spec.path else "")
            raise KeyError(
                refused
                or (number is None and _no_such_name(group, spec.path, names))
                or f"the object {object!r} holds no {field} at {path!r}"
            ) from None
        if spec.is_attribute:
            return value
        if spec.dtype == "json":
            return json.loads(value.asstr()[()])
        if spec.dtype == "text":
            return value.asstr()[()]
        return _decode(value) if spec.dtype == "png" else value[()]

    def surface(self, object: str, solidity: str = "solid") -> tuple[np.ndarray, np.ndarray]:
        """Return how a body's surface moves: its modal basis (V, 3, r) and the corrections (V, 3, c) there."""
        return self._shapes.surface(self.group(object)[solidity], (object, solidity))

    def _refused(self, object: str, solidity: str) -> str:
        """Return the sentence for an object that was refused, or its body of that solidity; empty where neither was."""
        for row in self.refusals:
            if row["object"] == object and row["solidity"] in ("", solidity):
                what = (
                    f"the {row['solidity']} body of {object!r}"
                    if row["solidity"]
                    else f"the object {object!r}"
                )
                said = f"{row['message']} {row['advice']}".strip()
                return f"{what} was refused at {row['stage']} ({row['reason']}): {said}"
        return ""

    def group(self, object: str):
        """Return the HDF5 group of an object, to look at anything in it. Raises :class:`KeyError` if unknown."""
        if object not in self._shard_of:
            raise KeyError(unknown("object", object, self._shard_of))
        groups = self._open(self._shard_of[object])["objects"]
        try:
            return groups[object]
        except KeyError:  # of a view (`vibraverse join`) whose dataset was moved
            raise FileNotFoundError(
                f"{self.shards[self._shard_of[object]]} links to {groups.get(object, getlink=True).filename}, which is "
                "not there; join the datasets again"
            ) from None

    def making(self) -> list[dict]:
        """Return how each shard was made: per stage its version, libraries and options."""
        return [json.loads(self._open(name)[schema.MAKING].asstr()[()]) for name in self.shards]

    def problems(self) -> list[str]:
        """Return what in the shards is not as the schema says, one sentence each; ``vibraverse check`` asks more."""
        from vibraverse.dataset.check.validator import problems

        return [
            f"{name}: {object_id + ': ' if object_id else ''}{sentence}"
            for name in self.shards
            for object_id, sentence in problems(self._open(name))
        ]

    def close(self) -> None:
        """Close the files of this process; the next access opens them again."""
        for handle in self._handles.values() if self._process == os.getpid() else ():
            handle.close()
        self._handles.clear()
        self._shapes = Shapes()

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def __getstate__(self) -> dict:
        return {**self.__dict__, "_handles": {}, "_shapes": Shapes()}

    def _open(self, shard: str):
        import h5py

        if self._process != os.getpid():  # forked: HDF5 handles must not be shared between processes
            self._handles, self._process = {}, os.getpid()
        handle = self._handles.pop(shard, None) or h5py.File(self.shards[shard], "r")
        self._handles[shard] = handle  # the latest used stand last
        if len(self._handles) > _MOST_OPEN:
            # Not closed but let go: HDF5 closes a file when nothing of it is in use any more.
            del self._handles[next(iter(self._handles))]
        return handle


def shards_at(path: str | Path) -> list[Path]:
    """Return the shards a path means: a shard itself, or those a dataset's folder lists in ``dataset.json``.

    Raises :class:`FileNotFoundError` when there is no dataset.
    """
    path = Path(path)
    if path.is_file():
        return [path]
    record = path / "dataset.json"
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; name a dataset's folder, or a shard")
    if wrong := unreadable(record):
        raise FileNotFoundError(f"{path} holds no finished dataset: {record} {wrong}")
    return [path / "shards" / name for name in json.loads(record.read_text(encoding="utf-8"))["shards"]]


def splits_at(path: str | Path) -> dict[str, str]:
    """Return the split of every object, as ``splits.tsv`` in a dataset's folder says it; for a shard, in its own.

    A view of several datasets holds its splits. Empty where there are none.
    """
    path = Path(path)
    if path.is_file():
        import h5py

        with h5py.File(path) as h5:
            if schema.SPLITS in h5:
                return _splits_in(h5[schema.SPLITS].asstr()[()])
    table = (path.parent.parent if path.is_file() else path) / "splits.tsv"
    return read_splits(table) if table.is_file() else {}


def read_splits(table: str | Path) -> dict[str, str]:
    """Return the split of every object from a ``splits.tsv``."""
    return _splits_in(Path(table).read_text(encoding="utf-8"))


def _splits_in(text: str) -> dict[str, str]:
    return {row["object"]: row["split"] for row in from_tsv(text, SPLIT_COLUMNS)}


def _field(name: str) -> schema.Field:
    if name not in schema.BY_NAME:
        raise KeyError(unknown("field", name, schema.BY_NAME))
    return schema.BY_NAME[name]


def _no_such_name(group, pattern: str, names: dict[str, str]) -> str:
    """Return that an object has no material, sound or look of that name, and which it has; empty where it has."""
    for kind in ("material", "sound", "look"):
        place = pattern.partition(f"/{{{kind}}}")[0].format(**names)
        if f"/{{{kind}}}" in pattern and place in group and names[kind] not in group[place]:
            return unknown(kind, names[kind], group[place])
    return ""


def _decode(pictures) -> np.ndarray:
    from PIL import Image

    return np.stack(
        [np.asarray(Image.open(io.BytesIO(png.tobytes())).convert("RGB")) for png in pictures[()]]
    )
