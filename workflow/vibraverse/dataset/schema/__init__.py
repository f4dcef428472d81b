"""The layout of a shard: the writer, the reader, the validator and ``docs/dataset.md`` follow this table.

A shard is an HDF5 file with one group ``objects/{object}`` per object;
:mod:`vibraverse.dataset.schema.fields` lists what that group holds.
"""

from __future__ import annotations

import re
from functools import cache

from vibraverse.dataset.schema.fields import FIELDS, Field
from vibraverse.dataset.schema.ranges import RANGES

#: Identifies a shard, and the version of this table.
FORMAT = "vibraverse-shard"
FORMAT_VERSION = 3

#: Identifies the columnar index, ``index.h5``, which follows the same version.
INDEX_FORMAT = "vibraverse-index"

#: Beginning of the sentence about a file that is not a shard.
NO_SHARD = "this is not a shard"

#: Texts at the root of a shard: its rows of the index and of the refusals (tab-separated), how it was made (JSON).
INDEX, REFUSALS, MAKING = "index", "refusals", "making"
#: Groups of the columnar index: its rows, and the shard of every object, refused ones included.
ITEMS, OBJECTS = "items", "objects"
#: Text with the splits, in a view of several datasets only: a shard does not know them.
SPLITS = "splits"

#: The list of checksums in every object's group (:mod:`vibraverse.dataset.schema.checksums`).
CHECKSUMS = "checksums"

#: Fields by name.
BY_NAME: dict[str, Field] = {field.name: field for field in FIELDS}

#: Columns of the index, one row per object, solidity and material: type and meaning.
INDEX_COLUMNS: dict[str, tuple[type, str]] = {
    "object": (str, "the object's id"),
    "solidity": (str, "`solid` or `hollow`"),
    "material": (str, "name of the material"),
    "shard": (str, "file in `shards/`"),
    "split": (str, "split of the object and of everything made of it"),
    "origin": (str, "generated, bundled, files or objaverse"),
    "category": (str, "shape family or category"),
    "title": (str, "name of the object"),
    "licence": (str, "licence of the source"),
    "size_m": (float, "longest side of the bounding box"),
    "size_origin": (
        str,
        "who says so: manifest, configuration, file (its unit), generated, bundled, or default",
    ),
    "volume_m3": (float, "volume of the body"),
    "mass_kg": (float, "mass of the body"),
    "tetrahedra": (int, "number of tetrahedra"),
    "modes": (int, "number of elastic modes"),
    "f1_hz": (float, "lowest eigenfrequency"),
    "f_last_hz": (float, "highest eigenfrequency kept"),
    "duration_s": (float, "length of the sound; 0 where there is none"),
    "sampled": (int, "sampled materials of the body, stored beside the named ones"),
}

#: Columns that a shard itself has: all but the split, which may depend on objects in other shards.
SHARD_COLUMNS = {name: column for name, column in INDEX_COLUMNS.items() if name != "split"}

#: Columns of the table of objects and their shards: type and meaning.
OBJECT_COLUMNS: dict[str, tuple[type, str]] = {
    "object": (str, "the object's id"),
    "shard": (str, "file in `shards/`"),
}

#: Columns of ``splits.tsv``, one row per object: type and meaning.
SPLIT_COLUMNS: dict[str, tuple[type, str]] = {
    "object": (str, "the object's id"),
    "split": (str, "its split"),
    "copy_of": (str, "the object whose shape it shares and whose side it takes; empty for a shape's first"),
}

#: Columns of the refusals, one row per refused object or body: type and meaning.
REFUSAL_COLUMNS: dict[str, tuple[type, str]] = {
    "object": (str, "the object's id"),
    "solidity": (str, "the refused body; empty when the whole object is refused"),
    "stage": (str, "stage that refused"),
    "reason": (str, "reason class"),
    "message": (str, "what is wrong"),
    "advice": (str, "what to do about it"),
}


@cache
def _patterns() -> tuple[tuple[re.Pattern, Field], ...]:
    compiled = []
    for field in FIELDS:
        pattern = re.escape(field.path).replace(r"\{solidity\}", "(?:solid|hollow)")
        compiled.append((re.compile(re.sub(r"\\{\w+\\}", "[^/@]+", pattern)), field))
    return tuple(compiled)


def knows(path: str) -> bool:
    """Return whether the table has a field at a filled-in path."""
    return any(pattern.fullmatch(path) for pattern, _ in _patterns())


def field_at(path: str) -> Field:
    """Return the field at a filled-in path such as ``hollow/materials/steel/frequencies_hz``.

    Raises :class:`KeyError` for a path that is not in the table.
    """
    for pattern, field in _patterns():
        if pattern.fullmatch(path):
            return field
    raise KeyError(f"the dataset has no field at {path!r}")


def strange(h5) -> str:
    """Return in one sentence why an open HDF5 file is not a shard of this version; "" if it is."""
    if h5.attrs.get("format") != FORMAT:
        return f"{NO_SHARD}: its attribute 'format' is not {FORMAT!r}"
    version = int(h5.attrs.get("format_version", 0))
    if version != FORMAT_VERSION:
        remedy = (
            "delete it and run the workflow again, which packs it anew from its products"
            if version < FORMAT_VERSION
            else "install a newer vibraverse"
        )
        return f"it follows version {version} of the schema and this is version {FORMAT_VERSION}; {remedy}"
    return ""


def markdown() -> str:
    """Return the tables of ``docs/dataset.md``."""
    lines = ["| field | path in `objects/{object}` | type | shape | unit | range | what it is |"]
    lines += ["| --- | --- | --- | --- | --- | --- | --- |"]
    for field in FIELDS:
        cells = (field.dtype, field.shape, field.unit or "–", RANGES.get(field.name, "–"), field.description)
        lines.append(f"| `{field.name}` | `{field.path}` | {' | '.join(cells)} |")
    tables = {"index.tsv": INDEX_COLUMNS, "splits.tsv": SPLIT_COLUMNS, "refusals.tsv": REFUSAL_COLUMNS}
    for title, columns in tables.items():
        lines += ["", f"| column of `{title}` | what it is |", "| --- | --- |"]
        lines += [f"| `{name}` | {text} |" for name, (_, text) in columns.items()]
    return "\n".join(lines) + "\n"
