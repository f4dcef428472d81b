"""Exports of a reader's items for other programs: what an item holds, and WebDataset's tars.

:mod:`vibraverse.dataset.publish.huggingface` writes the tables for ``datasets``.

Every file is bounded in size, appears whole or not at all, and has the same bytes for the same items.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from vibraverse.contract.products import sha256, whole
from vibraverse.dataset import schema
from vibraverse.dataset.read.items import Items
from vibraverse.dataset.read.reader import DEFAULT_FIELDS, Reader

#: Fields of an export by default.
EXPORTED = (*DEFAULT_FIELDS, "mass_kg", "occupancy", "sound", "views")
#: Columns of the index that every item includes.
_COLUMNS = ("object", "solidity", "material", "split", "origin", "category", "licence")


class CannotExport(ValueError):
    """What the requested format cannot hold, or this environment cannot write; one sentence."""


def by_split(reader: Reader) -> dict[str, Items]:
    """Return the items of each split in the order of the index; items of a single shard are in ``all``."""
    column = reader.items.column("split")
    return {
        split or "all": reader.items.part(np.flatnonzero(column.among({split}))) for split in column.present()
    }


def webdataset(
    reader: Reader, folder: Path, most_bytes: int, say: Callable[[str], None] = print
) -> list[Path]:
    """Write ``{split}-00000.tar``, …: an item is a group of files ``{object}__{solidity}__{material}.{what}``.

    ``json`` holds texts and numbers, ``{field}.npy`` an array, ``wav`` the sound, ``{view}.png`` the pictures. Returns
    the files written. A new tar begins before one would exceed ``most_bytes``.
    """
    written = []
    for split, items in by_split(reader).items():
        samples = (_members(reader, item) for item in items)
        for number, part in enumerate(
            parts(samples, lambda sample, _: sum(map(_tar_size, sample)), most_bytes)
        ):
            with whole(folder / f"{split}-{number:05d}.tar") as partial, tarfile.open(partial, "w") as tar:
                for name, content in (member for sample in part for member in sample):
                    header = tarfile.TarInfo(name)  # time 0 and no owner: the same items give the same bytes
                    header.size = len(content)
                    tar.addfile(header, io.BytesIO(content))
            written.append(folder / f"{split}-{number:05d}.tar")
            say(f"{written[-1].name}: {len(part)} items")
    return written


def checksums(folder: Path, files: Iterable[Path]) -> dict[str, dict]:
    """Return bytes and SHA-256 of files by path in the folder."""
    return {
        path.relative_to(folder).as_posix(): {"bytes": path.stat().st_size, "sha256": sha256(path)}
        for path in sorted(files)
    }


def parts(samples: Iterable, size_of: Callable, most_bytes: int) -> Iterator[list]:
    """Yield lists of samples of at most ``most_bytes`` together; a larger sample has a list of its own.

    ``size_of`` gets a sample and the one before it in its list, or None.
    """
    part, size = [], 0
    for sample in samples:
        more = size_of(sample, part[-1] if part else None)
        if part and size + more > most_bytes:
            yield part
            part, size = [], 0
            more = size_of(sample, None)
        part.append(sample)
        size += more
    if part:
        yield part


def _tar_size(member: tuple[str, bytes]) -> int:
    return 512 + -(-len(member[1]) // 512) * 512


def about(reader: Reader, item: dict) -> tuple[dict, dict[str, np.ndarray]]:
    """Return an item's texts and numbers, and its arrays, both by field and without sounds and pictures."""
    place = {name: item[name] for name in ("object", "solidity", "material")}
    plain, arrays = {name: item[name] for name in _COLUMNS}, {}
    for name in reader.fields:
        if name in ("sound", "views"):
            continue
        value = reader.read(name, **place)
        if isinstance(value, np.ndarray):
            arrays[name] = value
        else:
            plain[name] = value.item() if isinstance(value, np.generic) else value
    return plain, arrays


def wav(reader: Reader, item: dict) -> bytes | None:
    """Return the sound of an item as a 24-bit WAV file, the bit depth of its samples; None without a sound."""
    import soundfile

    place = {name: item[name] for name in ("object", "solidity", "material")}
    if "sound" not in reader.fields or not item["duration_s"]:
        return None
    file = io.BytesIO()
    rate = int(reader.read("sample_rate_hz", **place))
    soundfile.write(file, reader.read("sound", **place), rate, subtype="PCM_24", format="WAV")
    return file.getvalue()


def look_of(reader: Reader, item: dict) -> str:
    """Return the look of an item's pictures."""
    return item["material"] if reader.look == "material" else reader.look


def pngs(reader: Reader, object_id: str, look: str) -> list[bytes]:
    """Return the PNG files of an object's pictures."""
    path = schema.BY_NAME["views"].path.format(look=look)
    return [png.tobytes() for png in reader.group(object_id)[path][()]]


def _members(reader: Reader, item: dict) -> list[tuple[str, bytes]]:
    key = "__".join(item[name] for name in ("object", "solidity", "material"))
    plain, arrays = about(reader, item)
    members = [(f"{key}.json", json.dumps(plain, ensure_ascii=False).encode())]
    for name, array in arrays.items():
        file = io.BytesIO()
        np.save(file, array, allow_pickle=False)
        members.append((f"{key}.{name}.npy", file.getvalue()))
    sound = wav(reader, item)
    if sound is not None:
        members.append((f"{key}.wav", sound))
    pictures = pngs(reader, item["object"], look_of(reader, item)) if "views" in reader.fields else []
    return members + [(f"{key}.{view:02d}.png", png) for view, png in enumerate(pictures)]
