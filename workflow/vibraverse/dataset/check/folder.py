"""The check of a dataset's folder: files against their checksums, shards against the schema and the physics.

Every byte of a dataset is covered twice: ``SHA256SUMS`` lists all files (``sha256sum -c SHA256SUMS`` checks it without
our code), and ``dataset.json`` lists all but itself. If a shard's bytes are wrong, the checksums inside it
(:mod:`vibraverse.dataset.schema.checksums`) name the object.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vibraverse.contract import products
from vibraverse.contract.errors import Refused
from vibraverse.contract.limits import run_limited
from vibraverse.contract.readable import unreadable
from vibraverse.contract.refusal import said
from vibraverse.dataset.check.validator import DAMAGE
from vibraverse.dataset.read.index import TABLES as INDEXED
from vibraverse.dataset.schema import ITEMS, NO_SHARD, REFUSALS
from vibraverse.files.reading.document import parse
from vibraverse.flow.chain import shards_in

#: Limits of reading a shard whose bytes are wrong, because HDF5 may hang or crash on it.
_SHARD_SECONDS, _SHARD_MEMORY_MB = 3600, 8000
#: Names in a dataset's folder.
RECORD, SUMS, SHARDS, INDEX = "dataset.json", "SHA256SUMS", "shards/", "index.h5"
#: Text tables, with their names in an index.
TABLES = {"index.tsv": ITEMS, "refusals.tsv": REFUSALS}


class Finding(NamedTuple):
    """A finding: the file below the dataset's folder, the object ("" if none or unknown), and a sentence.

    A ``stranger`` is a file that does not belong to the dataset.
    """

    file: str
    object: str
    sentence: str
    stranger: bool = False

    def __str__(self) -> str:
        return f"{self.file}: {self.object + ': ' if self.object else ''}{self.sentence}"


def findings(path: str | Path, share: float = 0.0) -> Iterator[Finding]:
    """Yield the findings about a dataset's folder, or about one shard.

    About ``share`` of the items are recomputed (:mod:`vibraverse.dataset.check.recompute`). Raises
    :class:`FileNotFoundError` if the dataset does not exist.
    """
    path = Path(path)
    if path.is_file():
        found = list(_shard(path, path.name, share, trusted=False))
        if any(one.sentence.startswith(NO_SHARD) for one in found) or (found and path.suffix != ".h5"):
            raise FileNotFoundError(f"{path} is no shard of a dataset: {found[0].sentence}")
        yield from found
        return
    record = path / RECORD
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; name a dataset's folder, or a shard")
    if wrong := unreadable(record):
        hint = f"; there is one in {path / 'dataset'}" if (path / "dataset" / RECORD).is_file() else ""
        raise FileNotFoundError(f"{path} holds no finished dataset: {record} {wrong}{hint}")
    found = [name for name in _there(path) if (path / name).is_file()]
    actual = {name: products.sha256(path / name) for name in found}
    stated, wrong = _stated(record)
    sums, more = _sums(path / SUMS, {*actual, *stated})
    yield from (*wrong, *more)
    ours = {RECORD, *stated, *sums} if stated or sums else actual.keys()
    for name in dict.fromkeys([*stated, *sums, *actual]):
        if name not in ours:
            yield Finding(name, "", "it is no file of this dataset: move it away", stranger=True)
            continue
        said_by = {RECORD: stated.get(name), SUMS: sums.get(name)}
        if name == RECORD or not stated:
            del said_by[RECORD]
        yield from _file(path, name, actual.get(name), said_by, share)


def _file(path: Path, name: str, actual: str | None, said_by: dict, share: float) -> Iterator[Finding]:
    """Yield the findings about one file, and the lists that state a wrong checksum of it."""
    is_shard = name.startswith(SHARDS)
    right = actual is not None and actual in said_by.values()
    if actual is None:
        yield Finding(
            name, "", f"it is not there, but {' and '.join(w for w in said_by if said_by[w])} list it"
        )
        return
    for witness, digest in said_by.items():
        if digest is None:
            yield Finding(witness, "", f"it does not list {name}")
        elif right and digest != actual:
            yield Finding(witness, "", f"its checksum of {name} is wrong")
    inside = []
    if is_shard:
        inside = list(_shard(path / name, name, share, trusted=right))
    elif not right and name in (INDEX, *TABLES):
        inside = _table(path, name)
    yield from inside
    if not right and not inside:
        hint = ", though every object in it is whole" if is_shard else ""
        if name == RECORD:
            hint = ", or that line of it is wrong"
        yield Finding(name, "", f"its bytes are not those that {' and '.join(said_by)} state{hint}")


def _there(path: Path) -> list[str]:
    """Return the files in a dataset's folder, as paths below it, without partial and hidden ones."""
    others = sorted(file.name for file in path.iterdir() if file.is_file() and not file.name.startswith("."))
    return [*(SHARDS + shard.name for shard in shards_in(path)), *(name for name in others if name != SUMS)]


def _stated(record: Path) -> tuple[dict[str, str], list[Finding]]:
    """Return the checksums that dataset.json states, and the findings about it."""
    try:
        content = parse(record.read_bytes())
        shards, files = content.fields("shards"), content.fields("files")
        stated = {SHARDS + name: shards.fields(name).text("sha256") for name in shards.value}
        return stated | {name: files.fields(name).text("sha256") for name in files.value}, []
    except ValueError as error:
        return {}, [Finding(RECORD, "", f"it is not as `vibraverse index` writes it ({said(error)})")]


def _sums(path: Path, known: set[str]) -> tuple[dict[str, str], list[Finding]]:
    """Return the checksums that SHA256SUMS states for known files, and the findings about it."""
    if not path.is_file():
        return {}, [Finding(SUMS, "", "it is not there")]
    sums, wrong = {}, []
    *lines, end = path.read_bytes().decode(errors="replace").split("\n")
    if end:
        wrong.append(Finding(SUMS, "", "its last line does not end"))
    for number, line in enumerate(lines, 1):
        digest, blanks, name = line[:64], line[64:66], line[66:]
        if blanks == "  " and name in known:
            sums[name] = digest
        else:
            wrong.append(Finding(SUMS, "", f"line {number} names no file of this dataset: {line!r}"))
    return sums, wrong


def _shard(path: Path, name: str, share: float, trusted: bool) -> Iterator[Finding]:
    """Yield the findings about a shard; a child process reads a shard whose bytes may be wrong."""
    if trusted:
        found = _inside(str(path), share)
    else:
        limits = {"seconds": _SHARD_SECONDS, "memory_mb": _SHARD_MEMORY_MB}
        try:
            found = run_limited(_inside, str(path), share, **limits, what="Reading it")
        except Refused as refused:
            found = [("", _finding(refused))]
    yield from (Finding(name, *one) for one in found)


def _inside(path: str, share: float) -> list[tuple[str, str]]:
    """Return the findings inside a shard, as pairs of object and sentence."""
    import h5py

    from vibraverse.dataset.check.recompute import repeats
    from vibraverse.dataset.check.validator import problems

    try:
        with h5py.File(path, "r") as h5:
            return problems(h5, repeats(share))
    except OSError as error:
        return [("", f"HDF5 cannot open it ({said(error)})")]


def _finding(refused: Refused) -> str:
    """Return a refusal's sentence as a finding's, which follows the name of a file."""
    return (refused.message[:1].lower() + refused.message[1:]).rstrip(".")


def _table(path: Path, name: str) -> list[Finding]:
    """Return the first line of a table that differs from the shards, with its object; [] if a shard is broken."""
    from vibraverse.dataset.read.index import of_shards, splits_at

    try:
        index = of_shards(shards_in(path), splits_at(path))
    except DAMAGE:  # a broken shard has its own finding
        return []
    if name == INDEX:
        return _columns(path / name, index)
    table, columns = index.tables[TABLES[name]], INDEXED[TABLES[name]]
    lines = (path / name).read_text(encoding="utf-8", errors="replace").splitlines()
    expected = "".join(table.tsv(columns)).splitlines()
    for number, (line, right) in enumerate(itertools.zip_longest(lines, expected, fillvalue="")):
        if line != right:
            object_id = table.column("object").item(number - 1) if 0 < number <= len(table) else ""
            return [Finding(name, object_id, f"line {number + 1} is not what the shards say: {line!r}")]
    return []


def _columns(file: Path, index) -> list[Finding]:
    """Return the first row of the columnar index that differs from the shards, with its object."""
    limits = {"seconds": _SHARD_SECONDS, "memory_mb": _SHARD_MEMORY_MB}
    try:
        found = run_limited(_differences, file, index, **limits, what="reading it")
    except Refused as refused:
        found = [("", _finding(refused))]
    return [Finding(file.name, *one) for one in found]


def _differences(file: Path, index) -> list[tuple[str, str]]:
    """Return the differences of a columnar index from another index, as pairs of object and sentence."""
    from vibraverse.dataset.read.index import read_index

    try:
        stored = read_index(file, index.shards)
        for name, right in index.tables.items():
            for number, rows in enumerate(itertools.zip_longest(stored.tables[name].rows(), right.rows())):
                if rows[0] != rows[1]:
                    object_id = (rows[1] or rows[0])["object"]
                    return [(object_id, f"row {number + 1} of {name} is not what the shards say: {rows[0]}")]
    except DAMAGE as error:
        return [("", f"it cannot be read ({said(error)})")]
    return []
