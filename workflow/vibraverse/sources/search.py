"""Mesh files in a file, a folder or a glob, and the ids of their objects.

An id depends on a file's path below the given folder and on nothing else, so that adding files changes no
other id. The one exception: two paths that make the same id both get a short hash of their path.
"""

from __future__ import annotations

import glob
import os
import shutil
import stat
import unicodedata
from collections import defaultdict
from pathlib import Path
from typing import BinaryIO

from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import said
from vibraverse.contract.seeds import stable_hash
from vibraverse.files.formats.bounds import MAX_BYTES, TooLarge

#: File name extension -> format, for all that ``vibraverse.files.meshes`` reads.
FORMATS = {
    ".obj": "obj",
    ".stl": "stl",
    ".ply": "ply",
    ".off": "off",
    ".glb": "glb",
    ".gltf": "gltf",
    ".3mf": "3mf",
}

#: Formats whose files say how large a thing is.
SIZED = {"glb", "gltf", "3mf"}

_MAX_ID = 80
_LETTERS = str.maketrans(
    {"ß": "ss", "æ": "ae", "ø": "o", "œ": "oe", "đ": "d", "ð": "d", "þ": "th", "ł": "l", "ı": "i"}
)


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
                f"({known_formats()}, CSV, TSV)"
            )
        return identify([given], given.parent)
    if given.is_dir():
        files = list(_walk(given, made))
        if not files:
            raise NoMeshes(f"the folder {path} holds no mesh files; put some there ({known_formats()})")
        return identify(files, given)
    if glob.has_magic(str(given)):
        base = _fixed_part(given)
        files = _matching(base, given, made)
        if not files:
            raise NoMeshes(
                f"{path} matches no mesh file; change the pattern, or put some there ({known_formats()})"
            )
        return identify(files, base)
    if given.exists():
        raise NoMeshes(f"{path} is neither a file nor a folder; name one of these")
    raise NoMeshes(f"the file or folder {path} does not exist; name an existing one")


def open_regular(path: Path, name: str | None = None) -> BinaryIO:
    """Open a mesh file for reading, without waiting for a pipe or a device.

    Raises :class:`Refused`: ``unreadable`` where there is no file that may be read, ``too_large`` for one of
    more than ``MAX_BYTES``. ``name`` is what to call it (default: its own name).
    """
    name = name or path.name
    try:
        state = path.stat()
        if not stat.S_ISREG(state.st_mode):
            kind = "a folder" if stat.S_ISDIR(state.st_mode) else "a pipe or a device"
            raise Refused("unreadable", f"{name} is {kind} and not a file.", "Put a mesh file in its place.")
        if state.st_size > MAX_BYTES:
            raise Refused(
                "too_large",
                f"{name} has {state.st_size >> 20} MB; files of more than {MAX_BYTES >> 20} MB are not read.",
                "Simplify the mesh.",
            )
        return open(path, "rb")
    except OSError as error:
        raise Refused(
            "unreadable",
            f"{name} cannot be opened ({error.strerror}).",
            "Check that it exists, and its permissions.",
        ) from None


def as_one_file(path: Path, target: Path) -> tuple[str, float | None]:
    """Copy a mesh file to ``target``; return its format and the metres per unit it states (None where it states none).

    A .gltf becomes a GLB that holds its neighbours too. Raises :class:`Refused` (``unreadable``) when one is
    missing, or as :func:`open_regular` does; the bytes are not looked at otherwise.
    """
    format = FORMATS.get(path.suffix.lower(), "")
    with open_regular(path) as file:
        if format == "gltf" and os.fstat(file.fileno()).st_size:
            from vibraverse.files.formats.gltf import pack

            try:
                target.write_bytes(pack(file.read(), path.parent))
            except TooLarge as error:
                raise Refused("too_large", f"{path.name} {error}.", "Simplify the mesh.") from None
            except Exception as error:
                raise Refused(
                    "unreadable",
                    f"{path.name} could not be packed into one file: {said(error)}.",
                    "Export it as GLB, or put its buffers beside it.",
                ) from None
            return "glb", 1.0
        with open(target, "wb") as copy:
            shutil.copyfileobj(file, copy, 1 << 20)
        if format == "3mf":
            from vibraverse.files.formats.threemf import unit_m

            return format, unit_m(file)
    return format, 1.0 if format in SIZED else None


def is_mesh(name: str) -> bool:
    """Return whether a file's name says that it is a mesh."""
    return not name.startswith(".") and name.lower().endswith(tuple(FORMATS))


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
            id_ = object_ if len(found) == 1 else f"{object_}-{_short_hash(relative)}"
            if id_ in ids:
                raise NoMeshes(f"two files have the id {id_!r}: {ids[id_]} and {file}; rename one")
            ids[id_] = file
    return dict(sorted(ids.items()))


def slug(text: str) -> str:
    """Return ``text`` as an id of lower-case ASCII letters, digits, ``-`` and ``_``.

    Accents are dropped; a hash stands for letters that have no ASCII form and for what is too long.
    """
    lower = text.lower().translate(_LETTERS)
    plain = "".join(c for c in unicodedata.normalize("NFKD", lower) if not unicodedata.combining(c))
    kept = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "-" for c in plain)
    short = "-".join(part for part in kept.split("-") if part)
    lost = any(c.isalnum() and not c.isascii() for c in plain)
    if lost or not short or len(short) > _MAX_ID:
        short = "-".join(part for part in (short[: _MAX_ID - 9].strip("-"), _short_hash(text)) if part)
    return short


def _short_hash(text: str) -> str:
    return f"{stable_hash('file', unicodedata.normalize('NFC', text)) & 0xFFFFFFFF:08x}"


def known_formats() -> str:
    """Return the formats' names in a row, for a sentence."""
    return ", ".join(format.upper() for format in FORMATS.values())


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
