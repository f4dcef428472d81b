"""STL, binary or text. A binary file has 80 arbitrary bytes, the number of triangles, and 50 bytes for each."""

from __future__ import annotations

import struct
from typing import BinaryIO

from vibraverse.files.formats import Format, MeshData
from vibraverse.files.reading.bounds import Bounds
from vibraverse.files.reading.lines import as_utf8, encoding_of, invalid, lines

_HEADER, _TRIANGLE = 84, 50


def read(file: BinaryIO, bounds: Bounds) -> MeshData:
    """Return the triangles of an STL file; as in the format, they share no vertices."""
    import numpy as np

    head = file.read(1024)
    if _is_encoded_text(head):
        file.seek(0)
        file = as_utf8(file)
        head = file.read(1024)
    size = file.seek(0, 2)
    file.seek(0)
    count = struct.unpack_from("<I", head, 80)[0] if len(head) >= _HEADER else None
    needed = None if count is None else _HEADER + _TRIANGLE * count
    # Binary headers may start with "solid" too, but texts have no zero bytes.
    if head.lstrip()[:5].lower() == b"solid" and size != needed and b"\0" not in head:
        vertices = _text(file, bounds)
    elif needed is None:
        raise ValueError("it is neither a text nor a binary STL file")
    elif size < needed:
        raise ValueError(
            f"it states {count} triangles, which take {needed} bytes, and has {size}: it seems cut off"
        )
    else:
        bounds.check(triangles=count)
        file.seek(_HEADER)
        triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        triangles = np.frombuffer(file.read(needed - _HEADER), triangle)
        vertices = triangles["corners"].reshape(-1, 3).astype(np.float64)
    return MeshData(vertices, np.arange(len(vertices), dtype=np.int64).reshape(-1, 3))


def _is_encoded_text(head: bytes) -> bool:
    """Return whether a file begins with ``solid`` in UTF-16 or after a byte order mark; a binary header does not."""
    encoding = encoding_of(head)
    return encoding is not None and head.decode(encoding, "replace").lstrip()[:5].lower() == "solid"


def _text(file: BinaryIO, bounds: Bounds):
    """Return the vertices (3F, 3) of a text file."""
    from vibraverse.files.reading.polygons import Points

    points = Points(bounds)
    facets, closed = 0, True
    for number, line in lines(file):
        words = line.lower().split()
        if not words or words[0] == b"solid":
            closed = closed and not words  # a solid is open until its endsolid
            continue
        closed = words[0] in (b"endsolid", b"end")
        for at, word in enumerate(words):
            try:
                if word == b"vertex":
                    x, y, z = words[at + 1 : at + 4]
                    points.add(float(x), float(y), float(z))
                elif word == b"endloop" or word == b"endfacet":
                    facets += word == b"endloop"
                    if len(points) != 3 * facets:
                        raise ValueError("a facet has three vertices")
            except ValueError:
                raise invalid(number, line) from None
    if not closed or len(points) != 3 * facets:
        raise ValueError(f"it ends inside a solid, after {facets} triangles, and seems cut off")
    return points.array()


FORMAT = Format("STL", (".stl",), read)
