"""PLY, text and binary of either byte order: the positions of vertices and the corners of faces.

A header names elements with their number and properties; rows follow, element by element. A list property is a count
and that many numbers, so rows of one element may differ in length. A text is first turned into a binary file whose
every number is a double; from there both are read alike.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from typing import BinaryIO

import numpy as np

from vibraverse.files.formats.bounds import Bounds, TooLarge
from vibraverse.files.formats.polygons import triangulate
from vibraverse.geometry import Mesh

#: Type -> its code in ``struct``.
_TYPES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
_ORDERS = {b"binary_little_endian": "<", b"binary_big_endian": ">", b"ascii": ""}
_CORNERS = ("vertex_indices", "vertex_index")
_MAX_HEADER = 1 << 16
_CHUNK = 1 << 24
_BLOCK = 1 << 14

#: Numbers that a text may hold for each triangle allowed: three vertices of ten properties would need thirty.
_NUMBERS_PER_TRIANGLE = 32


@dataclass(frozen=True)
class _Property:
    """One property: its type and, where it is a list, that of its count; codes of ``struct``."""

    name: str
    type: str
    count: str | None = None


@dataclass
class _Element:
    name: str
    length: int
    properties: list[_Property] = field(default_factory=list)


def parse_ply(file: BinaryIO, bounds: Bounds) -> Mesh:
    """Return vertices (V, 3) and triangles (F, 3) of a PLY file.

    Raises ``ValueError`` or :class:`vibraverse.files.formats.bounds.TooLarge`.
    """
    order, elements = _header(file)
    lengths = {element.name: element.length for element in elements}
    _check_length(file, order, elements)
    bounds.check(vertices=lengths.get("vertex", 0), triangles=lengths.get("face", 0))
    if lengths.get("tristrips") and not lengths.get("face"):
        raise ValueError("it holds triangle strips, and only faces are read")
    if order:
        rows = _Rows(file.read(), order)
    else:
        rows = _Rows(_numbers(file, _NUMBERS_PER_TRIANGLE * bounds.max_triangles + 1000), "<")
        for element in elements:
            element.properties = [_Property(p.name, "d", p.count and "d") for p in element.properties]
    wanted = {"vertex", "face"} & set(lengths)
    vertices, polygons = np.zeros((0, 3)), None
    for element in elements if wanted else ():
        columns = rows.columns(element)
        if element.name == "vertex":
            vertices = _positions(columns)
        elif element.name == "face":
            polygons = _polygons(element, columns, bounds)
        wanted.discard(element.name)
        if not wanted:
            break
    return vertices, np.zeros((0, 3), np.int64) if polygons is None else triangulate(vertices, *polygons)


def _header(file: BinaryIO) -> tuple[str, list[_Element]]:
    """Return the byte order ("" for text) and the elements; the file stands behind the header afterwards."""
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
                elements.append(_Element(words[1], int(words[2])))
                if elements[-1].length < 0:
                    raise ValueError
            elif words[:2] == ["property", "list"]:
                _, _, count, type, name = words
                elements[-1].properties.append(_Property(name, _TYPES[type], _TYPES[count]))
            elif words[:1] == ["property"]:
                _, type, name = words
                elements[-1].properties.append(_Property(name, _TYPES[type]))
        except (ValueError, KeyError, IndexError):
            raise ValueError(f"its header has the line {' '.join(words)[:60]!r}") from None
    if order is None:
        raise ValueError("its header names no format")
    return order, elements


def _check_length(file: BinaryIO, order: str, elements: list[_Element]) -> None:
    """Raise ``ValueError`` if the file is too short for what its header announces, whatever its lists hold."""
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


def _numbers(file: BinaryIO, most: int) -> bytes:
    """Return the numbers of a text as doubles."""
    pieces, count, rest = [], 0, b""
    while chunk := file.read(_CHUNK):
        *words, rest = re.split(rb"\s+", rest + chunk)
        pieces.append(_doubles(words))
        count += len(pieces[-1])
        if count > most:
            raise TooLarge(f"holds more than {most} numbers")
    pieces.append(_doubles([rest]))
    return np.concatenate(pieces).astype("<f8").tobytes()


def _doubles(words: list[bytes]) -> np.ndarray:
    def number(word: bytes) -> float:
        try:
            return float(word)
        except ValueError:
            raise ValueError(
                f"{word[:40].decode('utf-8', 'replace')!r} stands where a number should"
            ) from None

    return np.fromiter((number(word) for word in words if word), np.float64)


class _Rows:
    """The rows behind the header, element by element."""

    def __init__(self, data: bytes, order: str):
        self.data, self.order, self.at = data, order, 0

    def columns(self, element: _Element) -> dict:
        """Return an element's properties by name: arrays, or for a list its numbers in a row and their counts.

        Raises ``ValueError`` when the file ends before the last row.
        """
        least = sum(struct.calcsize(self.order + (p.count or p.type)) for p in element.properties)
        if element.length * least > len(self.data) - self.at:
            raise ValueError(
                f"it announces {element.length} of {element.name} and seems cut off before they end"
            )
        if not element.length or not element.properties:
            nothing = np.zeros(0)
            return {
                p.name: (nothing, np.zeros(0, np.int64)) if p.count else nothing for p in element.properties
            }
        # Most files hold triangles alone, so the first row's shape is tried for all.
        return self._table(
            element, [len(value) for value in self._row(element, self.at, 0)[0]]
        ) or self._walk(element)

    def _row(self, element: _Element, at: int, number: int) -> tuple[list[memoryview], int]:
        """Return each property's numbers in the row that begins at ``at``, and where it ends."""
        values, view = [], memoryview(self.data)
        try:
            for prop in element.properties:
                size = 1
                if prop.count:
                    (size,) = struct.unpack_from(self.order + prop.count, self.data, at)
                    at += struct.calcsize(self.order + prop.count)
                stop = at + int(size) * struct.calcsize(self.order + prop.type)
                if int(size) != size or not at <= stop <= len(view):
                    raise ValueError
                values.append(view[at:stop])
                at = stop
        except (struct.error, ValueError, OverflowError):
            raise ValueError(
                f"it announces {element.length} of {element.name}, and number {number} is not valid or cut off"
            ) from None
        return values, at

    def _table(self, element: _Element, lengths: list[int]) -> dict | None:
        """Return the columns if every row has these lengths in bytes, else None."""
        fields = []
        for number, (prop, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if prop.count:
                fields.append((f"count{number}", self.order + prop.count))
            size = length // struct.calcsize(self.order + prop.type)
            fields.append((f"value{number}", self.order + prop.type, (size,)))
        row = sum(lengths) + sum(struct.calcsize(self.order + p.count) for p in element.properties if p.count)
        if row * element.length > len(self.data) - self.at:
            return None
        rows = np.frombuffer(self.data, np.dtype(fields), element.length, self.at)
        columns: dict = {}
        for number, prop in enumerate(element.properties):
            values = rows[f"value{number}"]
            if prop.count and (rows[f"count{number}"] != values.shape[1]).any():
                return None
            counts = np.full(element.length, values.shape[1], dtype=np.int64)
            columns[prop.name] = (values.reshape(-1), counts) if prop.count else values[:, 0]
        self.at += rows.nbytes
        return columns

    def _walk(self, element: _Element) -> dict:
        """Return the columns, row by row."""
        data: list[list[bytes]] = [[] for _ in element.properties]
        lengths: list[list[int]] = [[] for _ in element.properties]
        for first in range(0, element.length, _BLOCK):
            rows = []
            for number in range(first, min(first + _BLOCK, element.length)):
                values, self.at = self._row(element, self.at, number)
                rows.append(values)
            for column, pieces in enumerate(zip(*rows, strict=True)):
                data[column].append(b"".join(pieces))
                lengths[column].extend(map(len, pieces))
        columns: dict = {}
        for column, prop in enumerate(element.properties):
            values = np.frombuffer(b"".join(data[column]), self.order + prop.type)
            counts = np.array(lengths[column], dtype=np.int64) // values.itemsize
            columns[prop.name] = (values, counts) if prop.count else values
        return columns


def _positions(columns: dict) -> np.ndarray:
    missing = [axis for axis in "xyz" if not isinstance(columns.get(axis), np.ndarray)]
    if missing:
        raise ValueError(f"its vertices have no {', '.join(missing)}")
    return np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)


def _polygons(element: _Element, columns: dict, bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return corners in a row and their numbers, of the faces that have three or more."""
    lists = [prop.name for prop in element.properties if prop.count]
    name = next((name for name in _CORNERS if name in lists), lists[0] if len(lists) == 1 else None)
    if name is None:
        raise ValueError("its faces have no list vertex_indices")
    corners, sizes = columns[name]
    bounds.check(triangles=int(np.maximum(sizes - 2, 0).sum()))
    if corners.dtype.kind == "f" and not (np.abs(corners) < 2.0**53).all():
        raise ValueError("a face has a corner that is no number of a vertex")
    whole = corners.astype(np.int64)
    if not (whole == corners).all():
        raise ValueError("a face has a corner that is no whole number")
    if len(sizes) and sizes.min() < 3:  # points and edges bound nothing
        return whole[np.repeat(sizes >= 3, sizes)], sizes[sizes >= 3]
    return whole, sizes
