"""One view of several datasets: a small HDF5 file whose objects are links into their shards.

A view has the layout of a shard, so everything that reads shards reads it; the arrays stay where they are. Datasets can
be joined if they were made with the same stage versions and options, so that their numbers are comparable. Options that
change no number, or that the index states for every row, may differ.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from vibraverse.config.dataset import Dataset
from vibraverse.contract import products
from vibraverse.dataset import schema
from vibraverse.dataset.read.index import shards_at, splits_at
from vibraverse.dataset.read.reader import Reader
from vibraverse.dataset.schema import SPLIT_COLUMNS
from vibraverse.dataset.schema.columns import Table, Texts, joined
from vibraverse.dataset.schema.tables import to_tsv
from vibraverse.dataset.split.assignment import Splits, assign
from vibraverse.dataset.split.copies import fingerprints_of, groups
from vibraverse.dataset.write.making import VARIES, join

#: Options in which joined datasets may differ: limits of tools, and those that the index states for every row.
_COMPATIBLE_OPTIONS = {"limits", "sampled", "solidities", "looks", "size_m", "size_origin", "default_size_m"}


class NotAlike(ValueError):
    """Datasets that cannot be joined; one sentence."""


def join_datasets(folders: Sequence[Path], out: Path) -> int:
    """Write a view of datasets (folders or single shards) to ``out``; return the number of its objects.

    An object in several datasets counts once if it is the same in all. Raises :class:`NotAlike` if the datasets were
    made differently or hold different objects of one name. Raises :class:`ValueError` for a shard of another schema and
    for an existing ``out`` that is not a view. Raises :class:`FileNotFoundError` for a path that is not a dataset.
    """
    import h5py

    shards = [(folder, shard) for folder in folders for shard in shards_at(folder)]
    if out.resolve() in [shard.resolve() for _, shard in shards]:
        raise ValueError(f"{out} is one of the files to join; name another for the view")
    if out.exists() and not _is_view(out):
        raise ValueError(f"{out} is there and no view of datasets; name a new file")
    view = _View(out)
    splits = {folder: splits_at(folder) for folder in folders}
    for folder, shard in shards:
        with Reader([shard], splits=splits[folder]) as reader, h5py.File(shard) as h5:
            view.add(folder, shard, reader, h5)
    with products.whole(out) as partial, products.hdf5(partial) as h5:
        groups = h5.create_group("objects")
        for object_id, place in sorted(view.links.items()):
            groups[object_id] = h5py.ExternalLink(place, f"/objects/{object_id}")
        h5.attrs["format"], h5.attrs["format_version"] = schema.FORMAT, schema.FORMAT_VERSION
        rows = joined(view.rows, schema.SHARD_COLUMNS).sorted_by("object")
        refusals = sorted(view.refusals, key=lambda row: row["object"])
        h5.create_dataset(schema.INDEX, data="".join(rows.tsv(schema.SHARD_COLUMNS)))
        h5.create_dataset(schema.REFUSALS, data=to_tsv(refusals, schema.REFUSAL_COLUMNS))
        h5.create_dataset(schema.SPLITS, data=to_tsv(view.splits().rows(), SPLIT_COLUMNS))
        h5.create_dataset(schema.MAKING, data=json.dumps(join(view.makings), ensure_ascii=False))
    return len(view.links)


def _is_view(path: Path) -> bool:
    import h5py

    if not path.is_file() or not h5py.is_hdf5(path):
        return False
    with h5py.File(path) as h5:  # only a view holds splits
        return h5.attrs.get("format") == schema.FORMAT and schema.SPLITS in h5


class _View:
    """The content of a view, collected shard by shard."""

    def __init__(self, out: Path):
        self._out = out
        self._made: dict[str, tuple[dict, Path]] = {}
        self._content: dict[str, tuple[str, Path]] = {}
        self.links: dict[str, str] = {}
        self.rows: list[Table] = []
        self.refusals: list[dict] = []
        self.makings: list[dict] = []
        self._kept: dict[str, str] = {}
        self._fingerprints: dict[str, tuple] = {}

    def splits(self) -> Splits:
        """Return the splits of all objects: those of each dataset, but copies across datasets follow the first."""
        return assign(groups(self._fingerprints), Dataset().splits, kept=self._kept)

    def add(self, folder: Path, shard: Path, reader: Reader, h5) -> None:
        """Add a shard of the dataset at ``folder``."""
        making = reader.making()[0]
        self._compare(making, folder)
        self.makings.append(making)
        place = os.path.relpath(shard.resolve(), self._out.resolve().parent)
        fresh = set()
        for object_id, group in h5["objects"].items():
            content = group[schema.CHECKSUMS].asstr()[()]
            known, other = self._content.setdefault(object_id, (content, folder))
            if known != content:
                raise NotAlike(
                    f"{other} and {folder} both hold {object_id!r}, and not the same; make one of them without it"
                )
            if object_id not in self.links:
                self.links[object_id] = place
                fresh.add(object_id)
        table = reader.index.items
        table = table.take(table.column("object").among(fresh))
        kept = dict(zip(table.column("object").tolist(), table.column("split").tolist(), strict=True))
        self._kept |= {object_id: split for object_id, split in kept.items() if split}
        self._fingerprints |= fingerprints_of(reader, kept)
        here = Texts.of([place] * len(table))
        self.rows.append(table.with_columns(schema.SHARD_COLUMNS, shard=here))
        self.refusals += [row for row in reader.refusals if row["object"] in fresh]

    def _compare(self, making: dict, folder: Path) -> None:
        """Compare versions and options of each stage with the first dataset that has it; keep those that are new."""
        for stage, how in making.items():
            # The options of `sources` name each object's mesh, so they differ and do not count.
            mine = {
                "version": how.get("stage_version"),
                "options": how["options"] if stage != "sources" else {},
            }
            theirs, other = self._made.setdefault(stage, (mine, folder))
            difference = _difference(theirs, mine, stage)
            if difference:
                raise NotAlike(
                    f"{other} and {folder} were not made alike: {difference}; only datasets of one "
                    "configuration can be joined"
                )


def _difference(a, b, place: str) -> str:
    """Return the first difference that matters, as ``tets.target_elements is 5000 and 8000``; "" if none does."""
    if a == b or VARIES in (a, b):
        return ""
    if not (isinstance(a, dict) and isinstance(b, dict)):
        return f"{place} is {json.dumps(a, ensure_ascii=False)} and {json.dumps(b, ensure_ascii=False)}"
    # Only materials of the same name are compared; the index states which ones there are.
    keys = a.keys() & b.keys() if place.endswith(".materials") else {*a, *b} - _COMPATIBLE_OPTIONS
    for key in sorted(keys):
        found = _difference(a.get(key), b.get(key), place if key == "options" else f"{place}.{key}")
        if found:
            return found
    return ""
