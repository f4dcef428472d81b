"""Products: files that appear whole or not at all, and the provenance that each states."""

from __future__ import annotations

import errno
import glob
import hashlib
import importlib.metadata
import json
import os
import re
import shutil
from contextlib import contextmanager
from pathlib import Path

from vibraverse.contract.errors import NotStored

#: Remedies by errno, for the errors with which the system refuses to store a file.
_REMEDIES = {
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space, or ask for a larger quota",
    errno.EROFS: "make it writable, or choose another results folder",
    errno.EACCES: "make it writable, or choose another results folder",
    errno.EPERM: "make it writable, or choose another results folder",
}
#: Types of the errors that the system and HDF5 raise if a file cannot be written.
STORAGE_ERRORS = (OSError, RuntimeError, ValueError, LookupError)


def not_stored(error: BaseException, *paths: str | Path) -> str:
    """Return one sentence with a remedy if ``error`` means that ``paths`` cannot be stored; else "".

    The sentence names the first path. An unreadable file does not count. Libraries hide the system's error in a text:
    HDF5 writes ``errno = 28`` into its message, NumPy only how much of an array was written.
    """
    if isinstance(error, PermissionError) and not _concerns(error, [Path(path) for path in paths]):
        return ""
    number = error.errno if isinstance(error, OSError) else None
    if number is None:
        hidden = re.search(r"errno = (\d+)", str(error))
        number = int(hidden[1]) if hidden else None
        if re.search(r"\d+ requested and \d+ written", str(error)):
            number = errno.ENOSPC
    if number not in _REMEDIES:
        return ""
    place = _final(paths[0])
    return f"{place} cannot be written: {os.strerror(number)}; {_REMEDIES[number]}, then repeat the command."


def _concerns(error: OSError, paths: list[Path]) -> bool:
    """Return whether an error concerns one of ``paths``, its partial file, or a folder above or in it."""
    if error.filename is None:
        return True
    named = Path(os.fsdecode(error.filename))
    return any(
        path.is_relative_to(named) or named.is_relative_to(path) or named.is_relative_to(aside(path))
        for path in paths
    )


@contextmanager
def storing(*paths: str | Path):
    """Raise :class:`NotStored` in place of an error which means that ``paths`` cannot be stored."""
    try:
        yield
    except STORAGE_ERRORS as error:
        said = not_stored(error, *paths)
        if not said:
            raise
        raise NotStored(said) from error


def sha256(path: str | Path) -> str:
    """Return the hexadecimal SHA-256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def text_sha256(text: str) -> str:
    """Return the hexadecimal SHA-256 of a text in UTF-8."""
    return hashlib.sha256(text.encode()).hexdigest()


def aside(path: str | Path) -> Path:
    """Return the partial path beside ``path``, to which a product is written before it is renamed.

    The extension stays last because many writers choose the format by it.
    """
    path = Path(path)
    return path.with_name(f".{os.getpid()}.partial.{path.name}")


def _final(path: str | Path) -> Path:
    """Return a path with every partial name in it replaced by the final one."""
    return Path(*(re.sub(r"^\.\d+\.partial\.", "", part) for part in Path(path).parts))


def work_folder(path: str | Path) -> Path:
    """Return the folder beside ``path`` in which a stage keeps its state between attempts."""
    path = Path(path)
    return path.with_name(f".work.{path.name}")


def remove_partials(path: Path) -> None:
    """Remove the partial files and folders that a killed run left beside ``path``."""
    for stale in path.parent.glob(f".*.partial.{glob.escape(path.name)}"):
        _erase(stale)


def remove(path: Path) -> None:
    """Remove a file or a folder. A folder is renamed first, so that its name never points to half of its files."""
    if path.is_dir():
        gone = _gone(path)
        os.replace(path, gone)
        _erase(gone)
    else:
        path.unlink(missing_ok=True)


def publish(partial: Path, final: Path) -> None:
    """Flush ``partial``, a file or a folder with all its files, to disk and rename it to ``final``.

    A file replaces another atomically; an existing folder is moved away first.
    """
    for path in filter(Path.is_file, partial.rglob("*") if partial.is_dir() else [partial]):
        with open(path, "rb+") as file:
            os.fsync(file.fileno())
    gone = _gone(final)
    if final.is_dir():
        os.replace(final, gone)
    os.replace(partial, final)
    _erase(gone)


def _gone(path: Path) -> Path:
    """Return the name of a folder while it is removed; it counts as a partial name."""
    return path.with_name(f".{os.getpid()}.gone.partial.{path.name}")


def _erase(path: Path) -> None:
    """Remove a file or a folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def whole(path: str | Path):
    """Yield a temporary path for a file or folder; rename it to ``path`` on success, remove it on failure.

    Raises :class:`NotStored` if it cannot be written.
    """
    path = Path(path)
    partial = aside(path)
    with storing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield partial
            publish(partial, path)
        finally:
            _erase(partial)


@contextmanager
def hdf5(path: str | Path):
    """Yield an HDF5 file in memory, and write it to ``path`` as a whole at the end.

    HDF5 2.0 crashes after one of its own writes fails on a full disk. The bytes are those that it would have written.
    """
    import h5py

    with h5py.File(path, "w", driver="core", backing_store=False, block_size=2**20) as h5:
        yield h5
        h5.flush()
        image = h5.id.get_file_image()
    with storing(path):
        Path(path).write_bytes(image)


def write_text(path: str | Path, text: str) -> None:
    """Write UTF-8 text to ``path``, whole or not at all."""
    with whole(path) as partial:
        partial.write_text(text, encoding="utf-8")


def as_json(value) -> str:
    """Return JSON with the keys in the given order; NumPy numbers and arrays are allowed."""
    return json.dumps(value, indent=2, ensure_ascii=False, default=_plain) + "\n"


def write_json(path: str | Path, value) -> None:
    """Write JSON (see :func:`as_json`), whole or not at all."""
    write_text(path, as_json(value))


def _plain(value):
    """Convert NumPy scalars and arrays to JSON types."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"cannot store {type(value).__name__} as JSON")


def library_versions(names) -> dict[str, str]:
    """Return the installed versions of the named distributions."""
    return {name: importlib.metadata.version(name) for name in names}


def write_provenance(h5, provenance: dict) -> None:
    """Store the provenance of a product as one JSON attribute of an open HDF5 file."""
    h5.attrs["provenance"] = json.dumps(provenance, ensure_ascii=False, default=_plain)


def read_provenance(path: str | Path) -> dict:
    """Return the provenance stated in a product, a JSON record or an HDF5 file.

    Raises :class:`OSError`, :class:`ValueError` or :class:`LookupError` if it states none.
    """
    path = Path(path)
    if path.suffix == ".json":
        return read_json(path)["provenance"]
    import h5py

    with h5py.File(path) as file:
        return json.loads(file.attrs["provenance"])


def read_json(path: str | Path):
    """Read a JSON file."""
    return json.loads(Path(path).read_text(encoding="utf-8"))
