"""Manifests: tables of mesh files, one object per row, with its id, size, category and licence.

Snakemake reads the catalogue every time it starts. So this module uses only the standard library, and a manifest of
50,000 rows takes about a second.
"""

from __future__ import annotations

import csv
import difflib
import io
import math
import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vibraverse.contract.names import slug
from vibraverse.files.formats import is_mesh, names
from vibraverse.files.reading.lines import encoding_of
from vibraverse.physics.plausible import size_mistake
from vibraverse.sources.search import NoMeshes, wrong_characters

#: Column -> its meaning.
COLUMNS = {
    "path": "the mesh file, relative to the manifest",
    "id": "the object's id; default: the path without its extension, as of a file in a folder",
    "size_m": "longest side in metres, 0.001 to 50",
    "category": "what kind of thing it is",
    "licence": "its licence",
}

_EXTENSIONS = (".csv", ".tsv")
#: What programs write into an empty cell.
_EMPTY = frozenset({"NaN", "nan", "NA", "N/A", "n/a", "<NA>", "NULL", "null", "None"})
#: A column whose name is at least so similar to a known one is a misspelling; others are the owner's own.
_MISSPELLED = 0.82
#: Beginnings of names that mean a known column in another unit or spelling -> that column.
_MEANT = {"size": "size_m", "licen": "licence"}


@dataclass(frozen=True)
class Row:
    """One object of a manifest; empty cells are None."""

    object: str
    path: Path
    size_m: float | None = None
    category: str | None = None
    licence: str | None = None


def is_manifest(path: str) -> bool:
    """Return whether a path names a manifest, by its extension."""
    return path.lower().endswith(_EXTENSIONS)


def read_manifest(path: str, categories: Sequence[str] = ()) -> list[Row]:
    """Return the rows of a manifest, in order; ``categories``, if given, are the only valid ones.

    The first line names the columns, separated by commas, semicolons or tabs. Columns with other names, and one without
    a name, are ignored. Raises :class:`NoMeshes`, which lists every mistake with its line and column.
    """
    manifest = Path(path).expanduser()
    header, lines = _table(manifest)
    columns = _columns(manifest, header)
    mistakes: list[str] = []
    rows: list[Row] = []
    seen: dict[str, int] = {}
    for line, cells in lines:
        if len(cells) > len(header):
            mistakes.append(
                f"line {line}: {len(cells)} cells for {len(header)} columns; "
                "put quotes around a cell that holds a separator"
            )
            continue
        values = {name: _cell(cells, at) for name, at in columns.items()}
        values["path"] = _with_slashes(manifest.parent, values["path"])
        wrong = [
            f"line {line}, column {column}: {what}"
            for column, what in _row_mistakes(manifest, values, categories)
        ]
        if wrong:
            mistakes += wrong
            continue
        object_ = values.get("id") or slug("-".join(Path(values["path"]).with_suffix("").parts))
        if object_ in seen:
            mistakes.append(
                f"line {line}, column id: the id {object_!r} is that of line {seen[object_]} already; "
                "give one of them another id"
            )
            continue
        seen[object_] = line
        size_m = float(values["size_m"]) if values.get("size_m") else None
        file = manifest.parent / values["path"]
        rows.append(Row(object_, file, size_m, values.get("category") or None, values.get("licence") or None))
    if mistakes:
        raise NoMeshes(_message(path, mistakes))
    if not rows:
        raise NoMeshes(f"the manifest {path} lists no meshes; write a line for each below the first")
    return rows


def _table(manifest: Path) -> tuple[list[str], Iterator[tuple[int, list[str]]]]:
    """Return the cells of the first line, and the number and cells of every further line that is not empty."""
    text = _text(manifest)
    first = text.partition("\n")[0]
    named = first[4:5] if first.lower().startswith("sep=") else ""  # as spreadsheets write it
    separator = named or max(",;\t", key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True)

    def lines() -> Iterator[tuple[int, list[str]]]:
        try:
            for cells in reader:
                if any(cell.strip() for cell in cells):
                    yield reader.line_num, cells
        except csv.Error as error:
            raise NoMeshes(
                f"the manifest {manifest}, line {reader.line_num}: {error}; close the quotation mark"
            ) from None

    rows = lines()
    if named:
        next(rows)
    _, header = next(rows, (0, []))
    if not header:
        path, *others = COLUMNS
        raise NoMeshes(
            f"the manifest {manifest} is empty; name the column {path} in its first line, and any of "
            f"{', '.join(others)}, then write a line for each mesh"
        )
    return [cell.strip() for cell in header], rows


def _text(manifest: Path) -> str:
    """Return the text of a manifest: UTF-8, or UTF-16 with a byte order mark, as spreadsheets save it."""
    try:
        if not stat.S_ISREG(manifest.stat().st_mode):
            raise NoMeshes(f"the manifest {manifest} is not a file; name a CSV or TSV file")
        data = manifest.read_bytes()
        return data.decode(encoding_of(data[:4]) or "utf-8")
    except OSError as error:
        raise NoMeshes(
            f"the manifest {manifest} cannot be read ({error.strerror}); check path and permissions"
        ) from None
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise NoMeshes(
            f"the manifest {manifest}, line {line} is not UTF-8; save it as CSV in UTF-8"
        ) from None


def _cell(cells: Sequence[str], at: int) -> str:
    """Return the content of a cell; "" if it is missing or holds a word for nothing."""
    text = cells[at].strip() if at < len(cells) else ""
    return "" if text in _EMPTY else text


def _with_slashes(folder: Path, path: str) -> str:
    """Return a path with / for the backslashes of Windows, unless a file has them in its name."""
    return path if "\\" not in path or (folder / path).exists() else path.replace("\\", "/")


def _columns(manifest: Path, header: list[str]) -> dict[str, int]:
    """Return the position of each known column; raises :class:`NoMeshes` for a misspelt, double or missing one."""
    from vibraverse.contract.texts import unknown

    columns: dict[str, int] = {}
    mistakes = []
    names = [name.lower() for name in header]
    for at, name in enumerate(names):
        if name not in COLUMNS:
            meant = _meant(name)
            if meant and meant not in names:
                mistakes.append(f"line 1, column {at + 1}: {unknown('column', name, COLUMNS)}")
            continue
        if name in columns:
            mistakes.append(f"line 1, column {at + 1}: the column {name} appears twice; remove one")
        columns[name] = at
    if "path" not in columns:
        mistakes.append(f"line 1: the column path is missing; add it (known columns: {', '.join(COLUMNS)})")
    if mistakes:
        raise NoMeshes(_message(str(manifest), mistakes))
    return columns


def _meant(name: str) -> str | None:
    """Return the known column that a misspelt name probably means, or None for a column of the owner's own."""
    near = difflib.get_close_matches(name, COLUMNS, n=1, cutoff=_MISSPELLED)
    return (
        near[0] if near else next((known for start, known in _MEANT.items() if name.startswith(start)), None)
    )


def _row_mistakes(
    manifest: Path, values: dict[str, str], categories: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Yield the column and the description of every mistake in one row."""
    from vibraverse.contract.texts import unknown

    path = values["path"]
    if not path:
        yield "path", "the cell is empty; name a mesh file"
    elif wrong := wrong_characters(str(manifest.parent / path)):
        yield "path", f"{path!r} {wrong}; rename the file"
    elif not is_mesh(os.path.basename(path)):
        yield "path", f"{path} is not a mesh in a known format; export it as one ({names()})"
    else:
        wrong = _file_mistake(str(manifest.parent / path))
        if wrong:
            yield "path", f"{path} {wrong}"
    object_ = values.get("id")
    if object_ and slug(object_) != object_:
        yield (
            "id",
            f"{object_!r} is not an id of lower-case letters, digits, - and _; {slug(object_)!r} would be",
        )
    category = values.get("category")
    if category and categories and category not in categories:
        yield "category", unknown("category", category, categories)
    size = values.get("size_m")
    if not size:
        return
    if not _is_size(size):
        hint = "; write a decimal point" if _is_size(size.replace(",", ".")) else ""
        yield "size_m", f"{size!r} is not a positive number of metres{hint}"
    elif wrong := size_mistake(float(size)):
        yield "size_m", wrong


def _file_mistake(path: str) -> str:
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return "does not exist"
    return "" if stat.S_ISREG(mode) else "is not a file"


def _is_size(text: str) -> bool:
    try:
        return 0 < float(text) < math.inf
    except ValueError:
        return False


def _message(path: str, mistakes: list[str]) -> str:
    """Return one mistake as a sentence, and several as a list."""
    from vibraverse.contract.texts import listed

    subject = f"the manifest {path}"
    return f"{subject}, {mistakes[0]}" if len(mistakes) == 1 else listed(subject, mistakes)
