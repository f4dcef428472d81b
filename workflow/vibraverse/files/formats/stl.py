"""STL, binary and text. A binary file is 80 bytes of anything, the number of triangles, and 50 bytes for each."""

from __future__ import annotations

import struct
from typing import BinaryIO

import numpy as np

from vibraverse.files.formats.bounds import Bounds
from vibraverse.files.formats.textmeshes import parse_stl_text
from vibraverse.geometry import Mesh

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def parse_stl(file: BinaryIO, bounds: Bounds) -> Mesh:
    """Return vertices (3F, 3) and triangles (F, 3); no vertex is shared, as the format has it.

    Raises ``ValueError`` or :class:`vibraverse.files.formats.bounds.TooLarge`.
    """
    head = file.read(1024)
    size = file.seek(0, 2)
    file.seek(0)
    count = struct.unpack_from("<I", head, 80)[0] if len(head) >= 84 else None
    needed = None if count is None else 84 + _TRIANGLE.itemsize * count
    # Binary headers may begin with "solid" as well; texts hold no zero bytes.
    if head.lstrip()[:5].lower() == b"solid" and size != needed and b"\0" not in head:
        return parse_stl_text(file, bounds)
    if needed is None:
        raise ValueError("it is neither a text nor a binary STL file")
    if size < needed:
        raise ValueError(
            f"it states {count} triangles, which take {needed} bytes, and has {size}: it seems cut off"
        )
    bounds.check(triangles=count)
    file.seek(84)
    triangles = np.frombuffer(file.read(needed - 84), dtype=_TRIANGLE)
    vertices = triangles["corners"].reshape(-1, 3).astype(np.float64)
    return vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)
