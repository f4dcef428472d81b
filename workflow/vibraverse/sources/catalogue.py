"""The catalogue of all objects in a configuration: id, origin and the options of the stage ``sources``.

Snakemake reads the catalogue every time it starts, so this module loads no numerical library and opens no mesh.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path

from vibraverse.config import Config, ConfigError
from vibraverse.contract.texts import unknown
from vibraverse.sources.bundled import BUNDLED
from vibraverse.sources.families import FAMILIES, GROUPS, named
from vibraverse.sources.manifest import Row, is_manifest, read_manifest
from vibraverse.sources.search import NoMeshes, find


@dataclass(frozen=True)
class Entry:
    """One object: ``options`` are those of the stage ``sources``, ``input`` is the user's mesh file, if any.

    ``size_m`` is the longest side in metres that ``size_origin``, the configuration or a manifest, states; or None.
    """

    object: str
    origin: str
    options: dict = field(default_factory=dict)
    input: Path | None = None
    size_m: float | None = None
    size_origin: str | None = None


def catalogue(config: Config) -> dict[str, Entry]:
    """Return all objects by id, in the order of the configuration: generated, bundled, files, Objaverse.

    Raises :class:`vibraverse.config.ConfigError` for unknown names, missing folders and duplicate ids.
    """
    entries: dict[str, Entry] = {}
    for entry in _entries(config):
        other = entries.get(entry.object)
        if other is not None:
            raise ConfigError(
                f"two objects have the id {entry.object!r}: {_described(other)} and {_described(entry)}; "
                "rename one file, or list the folder above both"
            )
        entries[entry.object] = entry
    for object_, size_m in config.sources.sizes_m.items():
        if object_ not in entries:
            raise ConfigError(f"sources.sizes_m: {_unknown_object(object_, entries)}")
        entries[object_] = replace(entries[object_], size_m=size_m, size_origin="configuration")
    return entries


def generated_ids(count: int, families: list[str], first: int = 0) -> list[str]:
    """Return the ids of ``count`` generated objects: families in rotation, each numbered from ``first``."""
    return [
        f"{families[i % len(families)]}-{first + i // len(families):04d}" for i in range(count) if families
    ]


def _entries(config: Config):
    sources = config.sources
    chosen = sources.generated.families
    families = named([chosen] if isinstance(chosen, str) else chosen)
    for family in families:
        if family not in FAMILIES:
            raise ConfigError(
                f"sources.generated.families: {unknown('family', family, [*FAMILIES, *GROUPS])}"
            )
    for shape in generated_ids(sources.generated.count, families, sources.generated.first):
        for number in range(1, sources.generated.cavities + 1):
            object_ = shape if number == 1 else f"{shape}_{number}"
            yield Entry(object_, "generated", {"origin": "generated"})
    for object_ in dict.fromkeys(sources.bundled):
        if object_ not in BUNDLED:
            raise ConfigError(f"sources.bundled: {unknown('bundled model', object_, BUNDLED)}")
        yield Entry(object_, "bundled", {"origin": "bundled"})
    for number, files in enumerate(sources.files):
        if files.category and files.categories and files.category not in files.categories:
            wrong = unknown("category", files.category, files.categories)
            raise ConfigError(f"sources.files[{number}].category: {wrong}")
        try:
            if is_manifest(files.path):
                rows = read_manifest(files.path, files.categories)
            else:
                rows = [Row(object_, path) for object_, path in find(files.path, config.results).items()]
        except NoMeshes as error:
            raise ConfigError(f"sources.files[{number}].path: {error}") from None
        for row in rows:
            options = {"origin": "files", "licence": row.licence or files.licence}
            if category := row.category or files.category:
                options["category"] = category
            size_m = row.size_m or files.size_m
            origin = "manifest" if row.size_m else "configuration" if files.size_m else None
            yield Entry(row.object, "files", options, row.path, size_m, origin)
    for uid in dict.fromkeys(sources.objaverse.uids):
        if not re.fullmatch(r"[A-Za-z0-9_-]+", uid):
            raise ConfigError(f"sources.objaverse.uids: {uid!r} is not a UID; write letters and digits only")
        options = {"origin": "objaverse", "uid": uid, "cache": sources.objaverse.cache}
        yield Entry(f"objaverse-{uid.lower()}", "objaverse", options)


def _described(entry: Entry) -> str:
    return str(entry.input) if entry.input else f"{entry.origin} {entry.object}"


def _unknown_object(object_: str, entries: dict[str, Entry]) -> str:
    if not entries:
        return f"the run has no objects, so not {object_!r}; remove the key"
    return unknown("object", object_, list(entries))
