"""The reader of a dataset, with NumPy and h5py alone.

Handles are opened on first use in each process, so data-loader workers can use a reader: each opens its own handles and
index. A reader is pickled as the dataset's path and its row numbers.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from vibraverse.contract.texts import unknown
from vibraverse.dataset import schema
from vibraverse.dataset.read.index import Index, index_at, of_shards
from vibraverse.dataset.read.items import Items
from vibraverse.dataset.read.sampled import own_of, read_sampled
from vibraverse.dataset.read.shapes import Shapes
from vibraverse.physics.materials import sampled_number

#: Fields of a sample by default: those that every task needs, small and of the same shape for all bodies.
DEFAULT_FIELDS = ("frequencies_hz", "damping_per_s", "size_m", "density_kg_m3", "young_pa", "poisson")

#: Shards that a process keeps open. A system allows a process about 1,000 open files.
MAX_OPEN_SHARDS = 64


class Reader:
    """A dataset, or a part of it.

    ``index`` is its :class:`~vibraverse.dataset.read.index.Index`, or its shards (HDF5 files). ``len(reader)`` counts
    its items, one per object, solidity and material, ``reader.items[i]`` is a row of the index, and
    ``reader.items.column(name)`` one column of all. :meth:`sample` reads the chosen ``fields`` of an item,
    :meth:`read` one field of any object, :meth:`where` narrows the items and :meth:`with_sampled` adds the sampled
    materials.
    """

    def __init__(
        self,
        index: Index | Iterable[str | Path],
        fields: Sequence[str] = DEFAULT_FIELDS,
        look: str = "clay",
        splits: dict[str, str] | None = None,
    ):
        fields = tuple(fields)
        for name in fields:
            _field(name)
        index = index if isinstance(index, Index) else of_shards(index, splits)
        self._set(index, fields, look, None, None)

    @classmethod
    def at(cls, path: str | Path, fields: Sequence[str] = DEFAULT_FIELDS, look: str = "clay") -> Reader:
        """Open a dataset's folder, a shard or a view; raise :class:`FileNotFoundError` if it is none of these."""
        return cls(index_at(path), fields, look)

    def _set(self, index: Index, fields: tuple[str, ...], look: str, rows, samples) -> None:
        self.index, self.fields, self.look = index, fields, look
        self.items = Items(index.items, self._own, rows, samples)
        self._handles: dict[str, object] = {}
        self._shapes = Shapes()
        self._last: tuple = (None, None)
        self._process = os.getpid()

    def __getstate__(self) -> tuple:
        return self.index, self.fields, self.look, self.items.rows, self.items.samples

    def __setstate__(self, state: tuple) -> None:
        self._set(*state)

    def __len__(self) -> int:
        return len(self.items)

    def __getitem__(self, index: int) -> dict:
        return self.sample(self.items.place(index))

    def __iter__(self):
        return (self[number] for number in range(len(self)))

    @property
    def shards(self) -> dict[str, Path]:
        """The paths of the shards by name."""
        return self.index.shards

    @property
    def refusals(self) -> list[dict]:
        """The rows of the refusals, sorted by object."""
        return self.index.refusals

    @property
    def objects(self) -> list[str]:
        """The distinct ids of the items' objects, sorted."""
        return self.items.column("object").present()

    def where(self, **conditions) -> Reader:
        """Return a reader of the items whose columns have the given values (one value, or a collection).

        ``reader.where(split="train", material=["steel", "wood"])``. Raises :class:`KeyError` for an unknown column.
        """
        for name in conditions:
            if name not in schema.INDEX_COLUMNS:
                raise KeyError(unknown("column", name, schema.INDEX_COLUMNS))
        if "split" in conditions and "" in self.items.column("split").present():
            raise KeyError(
                "a shard alone knows no splits, which depend on all objects: open the dataset's folder"
            )
        return self._part(self.items.where(conditions))

    def part(self, positions: np.ndarray) -> Reader:
        """Return a reader of the items at these positions."""
        return self._part(self.items.part(positions))

    def with_sampled(self) -> Reader:
        """Return a reader with the named items, and after those of each body its sampled materials."""
        return self._part(self.items.with_sampled())

    def _part(self, items: Items) -> Reader:
        """Return a reader of other items in the same shards, with the same handles."""
        part = object.__new__(Reader)
        part.__dict__.update(self.__dict__)
        part.items = Items(self.index.items, part._own, items.rows, items.samples)
        return part

    def place(self, splits: dict[str, str]) -> None:
        """Set the split of each object; "" for an object that ``splits`` does not name."""
        self.index = self.index.placed(splits)
        self.items = Items(self.index.items, self._own, self.items.rows, self.items.samples)

    def _own(self, object: str, solidity: str) -> dict[str, np.ndarray]:
        """Return the columns in which a body's sampled materials differ; caches those of the last body."""
        if self._last[0] != (object, solidity):
            self._last = (object, solidity), own_of(self.group(object)[solidity])
        return self._last[1]

    def sample(self, item: dict) -> dict:
        """Return the chosen fields of an item by name, with ``object``, ``solidity`` and ``material``."""
        place = {name: item[name] for name in ("object", "solidity", "material")}
        return {**place, **{name: self.read(name, **place) for name in self.fields}}

    def read(self, field: str, object: str, solidity: str = "solid", material: str = "", **wildcards):
        """Return one field of one object: an array, a number, a text, a record (dict).

        ``views`` come decoded, (views, height, width, 3) uint8, in the reader's ``look`` (the look ``"material"``
        means that of the material) or in ``look=…``; ``sound`` is the material's, or ``sound=…``.
        Raises :class:`KeyError` if the dataset does not hold it; for a refused object or body, with stage and reason.
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
        """Return the modal basis (V, 3, r) and the corrections (V, 3, c) on a body's surface."""
        return self._shapes.surface(self.group(object)[solidity], (object, solidity))

    def _refused(self, object: str, solidity: str) -> str:
        """Return the sentence that an object or its body of that solidity was refused; "" if neither was."""
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
        """Return the HDF5 group of an object; raise :class:`KeyError` if it does not exist."""
        shard = self.index.shard_of.get(object)
        if shard is None:
            raise KeyError(unknown("object", object, self.index.shard_of))
        groups = self._open(shard)["objects"]
        try:
            return groups[object]
        except KeyError:  # a link of a view (`vibraverse join`) whose dataset was moved
            raise FileNotFoundError(
                f"{self.shards[shard]} links to {groups.get(object, getlink=True).filename}, which is "
                "not there; join the datasets again"
            ) from None

    def making(self) -> list[dict]:
        """Return how each shard was made: versions, libraries and options by stage."""
        return [json.loads(self._open(name)[schema.MAKING].asstr()[()]) for name in self.shards]

    def close(self) -> None:
        """Close the files of this process; the next access opens them again."""
        for handle in self._handles.values() if self._process == os.getpid() else ():
            handle.close()
        self._handles.clear()
        self._shapes, self._last = Shapes(), (None, None)

    def __enter__(self) -> Reader:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _open(self, shard: str):
        import h5py

        if self._process != os.getpid():  # forked: HDF5 handles must not be shared between processes
            self._handles, self._process = {}, os.getpid()
        handle = self._handles.pop(shard, None) or h5py.File(self.shards[shard], "r")
        self._handles[shard] = handle  # the most recently used come last
        if len(self._handles) > MAX_OPEN_SHARDS:
            # Dropped, not closed: HDF5 closes a file once none of its objects is in use.
            del self._handles[next(iter(self._handles))]
        return handle


def _field(name: str) -> schema.Field:
    if name not in schema.BY_NAME:
        raise KeyError(unknown("field", name, schema.BY_NAME))
    return schema.BY_NAME[name]


def _no_such_name(group, pattern: str, names: dict[str, str]) -> str:
    """Return the sentence that an object lacks a material, sound or look of that name, with those it has; else ""."""
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
