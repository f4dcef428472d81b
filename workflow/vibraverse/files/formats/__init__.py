"""Mesh formats: one module each, registered by the ``FORMAT`` that it defines.

To add a format, add a module here; extensions, messages and help follow from it. Snakemake lists the formats every time
it starts, so a module here loads no numerical library until its ``read`` is called. Shared code is in
:mod:`vibraverse.files.reading`.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    import numpy as np

    from vibraverse.files.reading.bounds import Bounds


@dataclass(frozen=True)
class MeshData:
    """The triangles in a file.

    ``vertices`` (V, 3) float64 are in the file's units, ``faces`` (F, 3) are int64. ``unit_m`` is metres per unit if
    the format states it (glTF is in metres, 3MF names its unit), else None. ``parts`` is the number of joined meshes.
    ``notes`` say what the format has the reader leave out or subtract. ``warnings`` say what may be missing: sentences
    for the owner of the file.
    """

    vertices: np.ndarray
    faces: np.ndarray
    unit_m: float | None = None
    parts: int = 1
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Format:
    """A mesh format: its name, its extensions and its reader."""

    name: str
    """Name in sentences: ``OBJ``."""
    extensions: tuple[str, ...]
    """Extensions in lower case with their dot; the first one, without its dot, is the key."""
    read: Callable[[BinaryIO, Bounds], MeshData]
    """Reader of an open file. Whatever the bytes, it raises only ``ValueError``, whose text completes "the file could
    not be read: …", or :class:`vibraverse.files.reading.bounds.TooLarge`, whose text completes "the file …"."""
    unit_m: Callable[[BinaryIO], float | None] | None = None
    """Reader of the metres per unit in a file, None for a damaged file. None if the format states no unit."""
    pack: Callable[[bytes, Path], bytes] | None = None
    """Packer of a file's bytes and its neighbours in a folder into one file for ``read``. Raises as ``read`` does, or
    ``OSError``. None if files of the format stand alone."""
    packed: str = ""
    """Key of the format that ``pack`` makes."""

    @property
    def key(self) -> str:
        """Key of the format in records and options: ``obj``."""
        return self.extensions[0].removeprefix(".")


@cache
def known() -> dict[str, Format]:
    """Return all formats by key, in the order of their names."""
    modules = (
        importlib.import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__)
    )
    formats = sorted((module.FORMAT for module in modules), key=lambda format: format.name.lower())
    return {format.key: format for format in formats}


@cache
def _by_extension() -> dict[str, Format]:
    return {extension: format for format in known().values() for extension in format.extensions}


def of_file(name: str | Path) -> Format | None:
    """Return the format of a file by its extension, or None."""
    return _by_extension().get(Path(name).suffix.lower())


def is_mesh(name: str) -> bool:
    """Return whether the name of a file is that of a mesh."""
    return not name.startswith(".") and of_file(name) is not None


def names(last: str = ", ") -> str:
    """Return the names of the formats for a sentence; ``last`` stands before the last name."""
    *most, end = (format.name for format in known().values())
    return ", ".join(most) + last + end
