"""Search for mesh files by file, folder or glob, and the ids of their objects.

An id depends only on the file's path below the given folder, so adding files changes no other id. The one exception:
if two paths give the same id, both get a short hash of their path.
"""

from __future__ import annotations

import glob
import os
from collections import defaultdict
from pathlib import Path

from vibraverse.contract.names import short_hash, slug
from vibraverse.files.formats import is_mesh, names


class NoMeshes(ValueError):
    """No meshes where some were expected; the message is one sentence, or a list of mistakes."""


def find(path: str, results: str = "") -> dict[str, Path]:
    """Return the mesh files at ``path`` (a file, a folder with its subfolders, or a glob), by object id.

    Hidden files and folders are skipped. So is the folder ``results`` if it lies below, because the products of a run
    would be the meshes of the next. Links to folders are followed, but not in circles and not by a glob's ``**``. The
    result is sorted by id. Raises :class:`NoMeshes` if no mesh is found.
    """
    given = Path(path).expanduser()
    results_folder = os.path.realpath(os.path.expanduser(results)) if results else ""
    if given.is_file():
        if not is_mesh(given.name):
            raise NoMeshes(
                f"the file {path} is neither a mesh nor a manifest; name one in a known format "
                f"({names()}, CSV, TSV)"
            )
        return identify([given], given.parent)
    if given.is_dir():
        files = list(_walk(given, results_folder))
        if not files:
            raise NoMeshes(f"the folder {path} holds no mesh files; put some there ({names()})")
        return identify(files, given)
    if glob.has_magic(str(given)):
        base = _fixed_part(given)
        files = _matches(base, given, results_folder)
        if not files:
            raise NoMeshes(f"{path} matches no mesh file; change the pattern, or put some there ({names()})")
        return identify(files, base)
    if given.exists():
        raise NoMeshes(f"{path} is neither a file nor a folder; name one of these")
    raise NoMeshes(f"the file or folder {path} does not exist; name an existing one")


def wrong_characters(path: str) -> str:
    """Return the end of a sentence about invalid characters in a mesh's path, or an empty string."""
    if not path.isprintable():  # logs must stay readable lines
        return "holds characters that cannot be printed"
    return "holds braces, which Snakemake takes for a wildcard" if "{" in path or "}" in path else ""


def identify(files: list[Path], base: Path) -> dict[str, Path]:
    """Return the files by id, the slug of their path below ``base`` with its parts joined by ``-``."""
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


def _walk(root: Path, results_folder: str):
    """Yield every mesh file below ``root`` once, except those in ``results_folder``."""
    top = os.path.realpath(root)
    seen = {top, results_folder}
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
                # A link to a folder inside the tree adds nothing: the walk visits that folder anyway, unless it is
                # hidden.
                inside = os.path.commonpath([real, top]) == top
                met = entry.is_symlink() and inside and not _is_hidden(os.path.relpath(real, top))
                if real not in seen and not met:
                    seen.add(real)
                    pending.append(Path(entry.path))
            elif is_file and is_mesh(entry.name):
                yield Path(entry.path)


def _matches(base: Path, pattern: Path, results_folder: str) -> list[Path]:
    """Return the mesh files below ``base`` that a glob matches, except those in ``results_folder``.

    ``**`` does not follow links.
    """
    try:
        found = list(base.glob(str(pattern.relative_to(base))))
    except ValueError:
        raise NoMeshes(
            f"{pattern} is not a valid glob: write '**', which means any folders, alone between slashes, as in **/*.obj"
        ) from None
    top = os.path.realpath(base)
    below = results_folder and results_folder != top and _is_in(results_folder, top)
    return [
        path
        for path in found
        if is_mesh(path.name) and not _is_hidden(path.relative_to(base)) and path.is_file()
        if not (below and _is_in(os.path.realpath(path), results_folder))
    ]


def _is_in(path: str, folder: str) -> bool:
    return os.path.commonpath([path, folder]) == folder


def _is_hidden(relative: str | Path) -> bool:
    """Return whether a file or folder, or one above it, is hidden; the walk visits none of these."""
    return any(part.startswith(".") for part in Path(relative).parts)


def _fixed_part(pattern: Path) -> Path:
    """Return the folder above the first part of a glob that has a wildcard."""
    fixed = []
    for part in pattern.parts[:-1]:
        if glob.has_magic(part):
            break
        fixed.append(part)
    return Path(*fixed)
