"""PLY, text or binary in either byte order: the positions of vertices and the corners of faces.

The header lists elements with their number of rows and their properties; the rows follow, element by element. A text is
first converted to a binary file of doubles, so both kinds share one reader.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from typing import BinaryIO

from vibraverse.files.formats import Format, MeshData
from vibraverse.files.reading.bounds import Bounds
from vibraverse.files.reading.lines import as_utf8
from vibraverse.files.reading.mistakes import Unsupported

#: Type -> its code in ``struct``.
_TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_ORDERS = {b"binary_little_endian": "<", b"binary_big_endian": ">", b"ascii": ""}
_MAX_HEADER = 1 << 16

#: Limit on the numbers in a text per allowed triangle; three vertices with ten properties would need thirty.
_NUMBERS_PER_TRIANGLE = 32


@dataclass(frozen=True)
class Property:
    """A property: its type and, if it is a list, the type of its count, as codes of ``struct``."""

    name: str
    type: str
    count: str | None = None


@dataclass
class Element:
    """An element of a header: its name, its number of rows and its properties."""

    name: str
    length: int
    properties: list[Property] = field(default_factory=list)


def read(file: BinaryIO, bounds: Bounds) -> MeshData:
    """Return the triangles of a PLY file: its faces, then its triangle strips."""
    import numpy as np

    from vibraverse.files.reading.polygons import triangulate
    from vibraverse.files.reading.rows import Rows, numbers, polygons, positions, stripped

    file = as_utf8(file)
    order, elements = _header(file)
    lengths = {element.name: element.length for element in elements}
    _check_length(file, order, elements)
    bounds.check(vertices=lengths.get("vertex", 0), triangles=lengths.get("face", 0))
    if lengths.get("range_grid") and not lengths.get("face") and not lengths.get("tristrips"):
        raise Unsupported(
            "it holds a grid of measured points (range_grid) and no faces",
            "Reconstruct a surface from the scan.",
        )
    if order:
        rows = Rows(file.read(), order)
    else:
        rows = Rows(numbers(file, _NUMBERS_PER_TRIANGLE * bounds.max_triangles + 1000), "<")
        for element in elements:
            element.properties = [Property(p.name, "d", p.count and "d") for p in element.properties]
    wanted = {"vertex", "face", "tristrips"} & set(lengths)
    vertices, faces, strips = np.zeros((0, 3)), None, np.zeros((0, 3), np.int64)
    for element in elements if wanted else ():
        columns = rows.columns(element)
        if element.name == "vertex":
            vertices = positions(columns)
        elif element.name == "face":
            faces = polygons(element, columns, bounds)
        elif element.name == "tristrips":
            strips = stripped(element, columns, bounds)
        wanted.discard(element.name)
        if not wanted:
            break
    triangles = strips if faces is None else triangulate(vertices, *faces)
    if faces is not None and len(strips):
        triangles = np.concatenate([triangles, strips])
        bounds.check(triangles=len(triangles))
    return MeshData(vertices, triangles)


def _header(file: BinaryIO) -> tuple[str, list[Element]]:
    """Return the byte order ("" for text) and the elements, and leave the file at the end of the header."""
    head = file.read(_MAX_HEADER)
    if not head.startswith(b"ply"):
        raise ValueError("it does not begin with ply")
    end = re.search(rb"[\r\n]end_header[ \t]*(\r\n|\n|\r)", head)
    if end is None:
        raise ValueError("its header has no end")
    file.seek(end.end())
    order, elements = None, []
    for line in head[: end.start()].splitlines()[1:]:
        words = line.decode("ascii", "replace").split()
        try:
            if words[:1] == ["format"]:
                order = _ORDERS[words[1].encode()]
            elif words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2])))
                if elements[-1].length < 0:
                    raise ValueError
            elif words[:2] == ["property", "list"]:
                _, _, count, type, name = words
                elements[-1].properties.append(Property(name, _TYPES[type], _TYPES[count]))
            elif words[:1] == ["property"]:
                _, type, name = words
                elements[-1].properties.append(Property(name, _TYPES[type]))
        except (ValueError, KeyError, IndexError):
            raise ValueError(f"its header has the line {' '.join(words)[:60]!r}") from None
    if order is None:
        raise ValueError("its header names no format")
    return order, elements


def _check_length(file: BinaryIO, order: str, elements: list[Element]) -> None:
    """Raise ``ValueError`` if the file is shorter than its header implies, even with empty lists."""
    start = file.tell()
    left = file.seek(0, 2) - start
    file.seek(start)
    for element in elements:
        row = sum(struct.calcsize(order + (p.count or p.type)) if order else 2 for p in element.properties)
        left -= element.length * row
        if left < -1:
            raise ValueError(
                f"it announces {element.length} of {element.name} and is cut off before they end"
            )


FORMAT = Format("PLY", (".ply",), read)
