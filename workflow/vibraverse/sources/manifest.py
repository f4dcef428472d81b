"""Manifests: tables of mesh files, one object per row, with its id, size, category and licence.

Snakemake reads the catalogue every time it starts. So this module uses only the standard library, and a manifest of
50,000 rows takes about a second.
"""

from __future__ import annotations

import csv
import io
import math
import os
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vibraverse.contract.names import slug
from vibraverse.files.formats import is_mesh, names
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

    The first line names the columns, separated by commas, semicolons or tabs. Raises :class:`NoMeshes`, which lists
    every mistake with its line and column.
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
        values = {name: cells[at].strip() if at < len(cells) else "" for name, at in columns.items()}
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
    try:
        if not stat.S_ISREG(manifest.stat().st_mode):
            raise NoMeshes(f"the manifest {manifest} is not a file; name a CSV or TSV file")
        text = manifest.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise NoMeshes(
            f"the manifest {manifest} cannot be read ({error.strerror}); check path and permissions"
        ) from None
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise NoMeshes(
            f"the manifest {manifest}, line {line} is not UTF-8; save it as CSV in UTF-8"
        ) from None
    first = text.partition("\n")[0]
    separator = max(",;\t", key=first.count)
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
    _, header = next(rows, (0, []))
    if not header:
        path, *others = COLUMNS
        raise NoMeshes(
            f"the manifest {manifest} is empty; name the column {path} in its first line, and any of "
            f"{', '.join(others)}, then write a line for each mesh"
        )
    return [cell.strip() for cell in header], rows


def _columns(manifest: Path, header: list[str]) -> dict[str, int]:
    """Return the position of each column; raises :class:`NoMeshes` for unknown, duplicate or missing names."""
    from vibraverse.contract.texts import unknown

    columns: dict[str, int] = {}
    mistakes = []
    for at, name in enumerate(header):
        name = name.lower()
        if name not in COLUMNS:
            mistakes.append(f"line 1, column {at + 1}: {unknown('column', name, COLUMNS)}")
        elif name in columns:
            mistakes.append(f"line 1, column {at + 1}: the column {name} appears twice; remove one")
        columns[name] = at
    if "path" not in columns:
        mistakes.append(f"line 1: the column path is missing; add it (known columns: {', '.join(COLUMNS)})")
    if mistakes:
        raise NoMeshes(_message(str(manifest), mistakes))
    return columns


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
            hint = "; write / between folders" if "\\" in path else ""
            yield "path", f"{path} {wrong}{hint}"
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
