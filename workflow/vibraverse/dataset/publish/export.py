"""Exports of a reader's items for other programs: WebDataset tars, and JSON lines or Parquet for ``datasets``.

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
#: Largest array, in numbers, that is written as JSON text.
_MAX_JSON_NUMBERS = 65_536


class CannotExport(ValueError):
    """A field or a table that the requested format cannot hold; one sentence."""


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
            _parts(samples, lambda sample: sum(map(_tar_size, sample)), most_bytes)
        ):
            with whole(folder / f"{split}-{number:05d}.tar") as partial, tarfile.open(partial, "w") as tar:
                for name, content in (member for sample in part for member in sample):
                    about = tarfile.TarInfo(
                        name
                    )  # time 0 and no owner, so that the same items give the same bytes
                    about.size = len(content)
                    tar.addfile(about, io.BytesIO(content))
            written.append(folder / f"{split}-{number:05d}.tar")
            say(f"{written[-1].name}: {len(part)} items")
    return written


def tables(
    reader: Reader, folder: Path, most_bytes: int, parquet: bool = False, say: Callable[[str], None] = print
) -> list[Path]:
    """Write ``data/{split}-00000.jsonl`` or ``.parquet``, …, a row per item; return all files written.

    Sounds and pictures are files below ``sounds/`` and ``views/``; rows name them by paths relative to ``folder``.
    Raises :class:`CannotExport` for an array too large for JSON, and for Parquet without pyarrow.
    """
    write, suffix = (_write_parquet, "parquet") if parquet else (_write_json_lines, "jsonl")
    media: dict[Path, None] = {}
    written = []
    for split, items in by_split(reader).items():
        rows = (_row(reader, item, folder, media, parquet) for item in items)
        for number, part in enumerate(_parts(rows, _row_size, most_bytes)):
            path = folder / f"data/{split}-{number:05d}.{suffix}"
            with whole(path) as partial:
                write(partial, part)
            written.append(path)
            say(f"data/{path.name}: {len(part)} items")
    return [*written, *media]


def checksums(folder: Path, files: Iterable[Path]) -> dict[str, dict]:
    """Return bytes and SHA-256 of files by path in the folder."""
    return {
        path.relative_to(folder).as_posix(): {"bytes": path.stat().st_size, "sha256": sha256(path)}
        for path in sorted(files)
    }


def _parts(samples: Iterable, size_of: Callable, most_bytes: int) -> Iterator[list]:
    """Yield lists of samples of at most ``most_bytes`` together; a larger sample has a list of its own."""
    part, size = [], 0
    for sample in samples:
        more = size_of(sample)
        if part and size + more > most_bytes:
            yield part
            part, size = [], 0
        part.append(sample)
        size += more
    if part:
        yield part


def _tar_size(member: tuple[str, bytes]) -> int:
    return 512 + -(-len(member[1]) // 512) * 512


def _about(reader: Reader, item: dict) -> tuple[dict, dict[str, np.ndarray]]:
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


def _sound(reader: Reader, item: dict) -> bytes | None:
    """Return the sound of an item as a 24-bit WAV file, the bit depth of its samples; None without a sound."""
    import soundfile

    place = {name: item[name] for name in ("object", "solidity", "material")}
    if "sound" not in reader.fields or not item["duration_s"]:
        return None
    file = io.BytesIO()
    rate = int(reader.read("sample_rate_hz", **place))
    soundfile.write(file, reader.read("sound", **place), rate, subtype="PCM_24", format="WAV")
    return file.getvalue()


def _pictures(reader: Reader, item: dict) -> tuple[str, list[bytes]]:
    """Return the look of an item's pictures and their PNG files; no files if pictures were not requested."""
    look = item["material"] if reader.look == "material" else reader.look
    if "views" not in reader.fields:
        return look, []
    path = schema.BY_NAME["views"].path.format(look=look)
    return look, [png.tobytes() for png in reader.group(item["object"])[path][()]]


def _members(reader: Reader, item: dict) -> list[tuple[str, bytes]]:
    key = "__".join(item[name] for name in ("object", "solidity", "material"))
    plain, arrays = _about(reader, item)
    members = [(f"{key}.json", json.dumps(plain, ensure_ascii=False).encode())]
    for name, array in arrays.items():
        file = io.BytesIO()
        np.save(file, array, allow_pickle=False)
        members.append((f"{key}.{name}.npy", file.getvalue()))
    sound = _sound(reader, item)
    if sound is not None:
        members.append((f"{key}.wav", sound))
    _, pictures = _pictures(reader, item)
    return members + [(f"{key}.{view:02d}.png", png) for view, png in enumerate(pictures)]


def _row(reader: Reader, item: dict, folder: Path, media: dict[Path, None], parquet: bool) -> dict:
    plain, arrays = _about(reader, item)
    for name, array in arrays.items():
        if array.size > _MAX_JSON_NUMBERS and not parquet:
            raise CannotExport(
                f"{name} holds {array.size:,} numbers for every item, too many for JSON: leave it out, or choose "
                "--parquet or --format webdataset"
            )
        plain[name] = array if parquet else array.tolist()
    if "sound" in reader.fields:
        sound = _sound(reader, item)
        name = f"sounds/{item['object']}/{item['solidity']}-{item['material']}.wav"
        plain["sound"] = None if sound is None else _written(folder / name, sound, folder, media)
    if "views" in reader.fields:
        look, pictures = _pictures(reader, item)
        names = [folder / f"views/{item['object']}/{look}-{view:02d}.png" for view in range(len(pictures))]
        plain["views"] = [_written(*both, folder, media) for both in zip(names, pictures, strict=True)]
    return plain


def _written(path: Path, content: bytes, folder: Path, media: dict[Path, None]) -> str:
    """Write a file once, and return its path in the folder."""
    if path not in media:
        with whole(path) as partial:
            partial.write_bytes(content)
        media[path] = None
    return path.relative_to(folder).as_posix()


def _row_size(row: dict) -> int:
    return sum(value.nbytes if isinstance(value, np.ndarray) else len(str(value)) for value in row.values())


def _write_json_lines(path: Path, rows: list[dict]) -> None:
    lines = (json.dumps(row, ensure_ascii=False) + "\n" for row in rows)
    path.write_text("".join(lines), encoding="utf-8")


def _write_parquet(path: Path, rows: list[dict]) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise CannotExport(
            "Parquet needs pyarrow, which this environment lacks; run `pip install pyarrow`"
        ) from None
    columns = {}
    for name in rows[0]:
        values = [row[name] for row in rows]
        if isinstance(values[0], np.ndarray):
            depth, kind = values[0].ndim, pyarrow.from_numpy_dtype(values[0].dtype)
            for _ in range(depth):
                kind = pyarrow.list_(kind)
            columns[name] = pyarrow.array([value.tolist() for value in values], type=kind)
        elif isinstance(values[0], dict):
            columns[name] = pyarrow.array([json.dumps(value, ensure_ascii=False) for value in values])
        else:
            columns[name] = pyarrow.array(values)
    pyarrow.parquet.write_table(pyarrow.table(columns), path, compression="zstd")
