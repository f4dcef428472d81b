"""Mesh formats: a module each, which registers itself by the ``FORMAT`` that it defines.

To add a format, add a module here; extensions, messages and help derive from it. Snakemake lists the formats each time
it starts, so a module here loads no numerical library until its ``read`` is called. What several of them need is in
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
    """Triangles as a file states them.

    ``vertices`` (V, 3) float64 in the file's units, ``faces`` (F, 3) int64, ``unit_m`` metres per unit where
    the format states it (glTF is in metres, 3MF names its unit) and None elsewhere, ``parts`` how many meshes
    were joined.
    """

    vertices: np.ndarray
    faces: np.ndarray
    unit_m: float | None = None
    parts: int = 1


@dataclass(frozen=True)
class Format:
    """A mesh format: what it is called and how it is read."""

    name: str
    """As sentences say it: ``OBJ``."""
    extensions: tuple[str, ...]
    """In lower case with their dot; the first, without it, is the format's key in records."""
    read: Callable[[BinaryIO, Bounds], MeshData]
    """Reads an open file. Raises ``ValueError`` or :class:`vibraverse.files.reading.bounds.TooLarge` with a text that
    completes "the file could not be read: …" or "the file …", and nothing else whatever the bytes are."""
    unit_m: Callable[[BinaryIO], float | None] | None = None
    """Returns the metres per unit that a file states, None for a damaged one. None where the format states no unit."""
    pack: Callable[[bytes, Path], bytes] | None = None
    """Returns one file that holds a file's bytes and its neighbours in a folder, which is what ``read`` reads then.
    Raises as ``read`` does, and ``OSError``. None where files stand alone."""
    packed: str = ""
    """Key of the format that ``pack`` makes."""

    @property
    def key(self) -> str:
        """What records and options call the format: ``obj``."""
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
    """Return the format that a file's extension tells, None for an unknown one."""
    return _by_extension().get(Path(name).suffix.lower())


def is_mesh(name: str) -> bool:
    """Return whether a file's name says that it is a mesh."""
    return not name.startswith(".") and of_file(name) is not None


def names(last: str = ", ") -> str:
    """Return the formats' names in a row, for a sentence; ``last`` stands before the last of them."""
    *most, end = (format.name for format in known().values())
    return ", ".join(most) + last + end
