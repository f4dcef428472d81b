"""Opening and copying of mesh files, whatever their contents."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path
from typing import BinaryIO

from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import said
from vibraverse.files.formats import of_file
from vibraverse.files.reading.bounds import MAX_BYTES, TooLarge
from vibraverse.files.reading.mistakes import Unsupported


def open_regular(path: Path, name: str | None = None) -> BinaryIO:
    """Open a mesh file for reading, without waiting for a pipe or a device.

    ``name`` is the name of the file in refusals (default: its own). Raises :class:`Refused` with reason ``unreadable``
    if it is not a readable file, ``too_large`` if it has more than ``MAX_BYTES``.
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
            "unreadable", f"{name} cannot be opened ({error.strerror}).", "Check the file's permissions."
        ) from None


def as_one_file(path: Path, target: Path) -> tuple[str, float | None]:
    """Copy a mesh file to ``target``; return the key of its format and the metres per unit that it states, or None.

    A .gltf becomes a GLB that includes its neighbours. The bytes are not checked otherwise. Raises :class:`Refused` as
    :func:`open_regular` does, and if a neighbour is missing (``unreadable``).
    """
    format = of_file(path)
    with open_regular(path) as file:
        unit_m = format.unit_m(file) if format and format.unit_m else None
        file.seek(0)
        if format and format.pack and os.fstat(file.fileno()).st_size:
            try:
                packed = format.pack(file.read(), path.parent)
            except TooLarge as error:
                raise Refused("too_large", f"{path.name} {error}.", "Simplify the mesh.") from None
            except MemoryError:
                raise Refused(
                    "too_large", f"{path.name} needs more memory than is available.", "Simplify the mesh."
                ) from None
            except Unsupported as error:
                raise Refused(
                    "unreadable",
                    f"{path.name} could not be read as {format.name}: {said(error)}.",
                    error.advice,
                ) from None
            except (ValueError, OSError) as error:
                raise Refused(
                    "unreadable",
                    f"{path.name} could not be packed into one file: {said(error)}.",
                    "Export it as GLB, or put its buffers beside it.",
                ) from None
            target.write_bytes(packed)
            return format.packed, unit_m
        with open(target, "wb") as copy:
            shutil.copyfileobj(file, copy, 1 << 20)
    return format.key if format else "", unit_m
