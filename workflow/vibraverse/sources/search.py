"""Mesh files in a file, a folder or a glob, and the ids of their objects.

An id depends on a file's path below the given folder and on nothing else, so that adding files changes no
other id. The one exception: two paths that make the same id both get a short hash of their path.
"""

from __future__ import annotations

import glob
import os
from collections import defaultdict
from pathlib import Path

from vibraverse.contract.names import short_hash, slug
from vibraverse.files.formats import is_mesh, names


class NoMeshes(ValueError):
    """Nothing to read where meshes were expected; the message is one sentence."""


def find(path: str, results: str = "") -> dict[str, Path]:
    """Return the mesh files at ``path`` (a file, a folder with its subfolders, or a glob), by object id.

    Hidden files and folders are left out, and so is the folder ``results`` where it lies below: what a run makes of
    meshes would be the next run's meshes. Links to folders are followed, but not in circles and not by a
    glob's ``**``. Sorted by id.
    Raises :class:`NoMeshes` when there is nothing.
    """
    given = Path(path).expanduser()
    made = os.path.realpath(os.path.expanduser(results)) if results else ""
    if given.is_file():
        if not is_mesh(given.name):
            raise NoMeshes(
                f"the file {path} is neither a mesh nor a manifest; name one in a known format "
                f"({names()}, CSV, TSV)"
            )
        return identify([given], given.parent)
    if given.is_dir():
        files = list(_walk(given, made))
        if not files:
            raise NoMeshes(f"the folder {path} holds no mesh files; put some there ({names()})")
        return identify(files, given)
    if glob.has_magic(str(given)):
        base = _fixed_part(given)
        files = _matching(base, given, made)
        if not files:
            raise NoMeshes(f"{path} matches no mesh file; change the pattern, or put some there ({names()})")
        return identify(files, base)
    if given.exists():
        raise NoMeshes(f"{path} is neither a file nor a folder; name one of these")
    raise NoMeshes(f"the file or folder {path} does not exist; name an existing one")


def wrong_characters(path: str) -> str:
    """Return what no path of a mesh may hold, as the end of a sentence; nothing for a usable path."""
    if not path.isprintable():  # logs are lines of UTF-8
        return "holds characters that cannot be printed"
    return "holds braces, which Snakemake takes for a wildcard" if "{" in path or "}" in path else ""


def identify(files: list[Path], base: Path) -> dict[str, Path]:
    """Return the files by id: the slug of their path below ``base``, joined by ``-``."""
    by_id: dict[str, list[tuple[str, Path]]] = defaultdict(list)
    for file in files:
        if wrong := wrong_characters(str(file)):
            raise NoMeshes(f"the file name {str(file)!r} {wrong}; rename it")
        relative = Path(os.path.relpath(file, base))
        by_id[slug("-".join(relative.with_suffix("").parts))].append((relative.as_posix(), file))
    ids: dict[str, Path] = {}
    for object_, found in by_id.items():
        for relative, file in found:
            id_ = object_ if len(found) == 1 else f"{object_}-{short_hash(relative)}"
            if id_ in ids:
                raise NoMeshes(f"two files have the id {id_!r}: {ids[id_]} and {file}; rename one")
            ids[id_] = file
    return dict(sorted(ids.items()))


def _walk(root: Path, made: str):
    """Yield the mesh files below ``root``, each once, without those in the folder ``made``."""
    top = os.path.realpath(root)
    seen = {top, made}
    pending = [root]
    while pending:
        folder = pending.pop()
        try:
            entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
        except OSError:
            continue
        for entry in entries:
            if entry.name.startswith("."):
                continue
            try:
                is_folder, is_file = entry.is_dir(), entry.is_file()
            except OSError:  # a link to itself
                continue
            if is_folder:
                real = os.path.realpath(entry.path)
                # A link to a folder inside the tree adds nothing: that folder is met under its own name, if not hidden.
                inside = os.path.commonpath([real, top]) == top
                met = entry.is_symlink() and inside and not _is_hidden(os.path.relpath(real, top))
                if real not in seen and not met:
                    seen.add(real)
                    pending.append(Path(entry.path))
            elif is_file and is_mesh(entry.name):
                yield Path(entry.path)


def _matching(base: Path, pattern: Path, made: str) -> list[Path]:
    """Return the mesh files below ``base`` that a glob matches, without those in the folder ``made``.

    ``**`` does not follow links.
    """
    try:
        found = list(base.glob(str(pattern.relative_to(base))))
    except ValueError:
        raise NoMeshes(
            f"{pattern} is not a valid glob: write '**', which means any folders, alone between slashes, as in **/*.obj"
        ) from None
    top = os.path.realpath(base)
    below = made and made != top and _is_in(made, top)
    return [
        path
        for path in found
        if is_mesh(path.name) and not _is_hidden(path.relative_to(base)) and path.is_file()
        if not (below and _is_in(os.path.realpath(path), made))
    ]


def _is_in(path: str, folder: str) -> bool:
    return os.path.commonpath([path, folder]) == folder


def _is_hidden(relative: str | Path) -> bool:
    """Return whether a file or folder, or one above it, is hidden; a walk meets none of these."""
    return any(part.startswith(".") for part in Path(relative).parts)


def _fixed_part(pattern: Path) -> Path:
    """Return the folder above the first part of a glob that has a wildcard."""
    fixed = []
    for part in pattern.parts[:-1]:
        if glob.has_magic(part):
            break
        fixed.append(part)
    return Path(*fixed)
