"""The rows of PLY elements as arrays.

A list property is a count, followed by that many numbers, so the rows of an element may differ in length.
"""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from vibraverse.files.reading.bounds import Bounds, TooLarge
from vibraverse.files.reading.polygons import strips

if TYPE_CHECKING:
    from vibraverse.files.formats.ply import Element

_CORNERS = ("vertex_indices", "vertex_index")
_CHUNK_BYTES = 1 << 24
_BLOCK_ROWS = 1 << 14

#: Numbers that a triangle takes in strips of one triangle each.
_MOST_CORNERS = 4


def numbers(file: BinaryIO, most: int) -> bytes:
    """Return the bytes of the numbers in a text as doubles; raises :class:`TooLarge` for more than ``most``."""
    pieces, count, rest = [], 0, b""
    while chunk := file.read(_CHUNK_BYTES):
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


class Rows:
    """The rows after the header, element by element."""

    def __init__(self, data: bytes, order: str):
        self.data, self.order, self.at = data, order, 0

    def columns(self, element: Element) -> dict:
        """Return the properties of an element by name: an array, or for a list its numbers in sequence and the counts.

        Raises ``ValueError`` if the file ends before the last row.
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
        # Most files hold only triangles, so the lengths of the first row are tried for all.
        return self._table(
            element, [len(value) for value in self._row(element, self.at, 0)[0]]
        ) or self._walk(element)

    def _row(self, element: Element, at: int, number: int) -> tuple[list[memoryview], int]:
        """Return the numbers of each property in the row that starts at ``at``, and the end of the row."""
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

    def _table(self, element: Element, lengths: list[int]) -> dict | None:
        """Return the columns if all rows have these lengths in bytes, else None."""
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

    def _walk(self, element: Element) -> dict:
        """Return the columns, row by row."""
        data: list[list[bytes]] = [[] for _ in element.properties]
        lengths: list[list[int]] = [[] for _ in element.properties]
        for first in range(0, element.length, _BLOCK_ROWS):
            rows = []
            for number in range(first, min(first + _BLOCK_ROWS, element.length)):
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


def positions(columns: dict) -> np.ndarray:
    """Return the positions (V, 3) in the columns x, y and z."""
    missing = [axis for axis in "xyz" if not isinstance(columns.get(axis), np.ndarray)]
    if missing:
        raise ValueError(f"its vertices have no {', '.join(missing)}")
    return np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)


def polygons(element: Element, columns: dict, bounds: Bounds) -> tuple[np.ndarray, np.ndarray]:
    """Return corners in sequence and their numbers for all faces with at least three."""
    corners, sizes = _lists(element, columns)
    bounds.check(triangles=int(np.maximum(sizes - 2, 0).sum()))
    whole = _whole(corners)
    if len(sizes) and sizes.min() < 3:  # points and edges bound nothing
        return whole[np.repeat(sizes >= 3, sizes)], sizes[sizes >= 3]
    return whole, sizes


def stripped(element: Element, columns: dict, bounds: Bounds) -> np.ndarray:
    """Return the triangles (F, 3) of triangle strips; -1 ends a strip, and so does the end of a row."""
    corners, sizes = _lists(element, columns)
    bounds.check(triangles=len(corners) // _MOST_CORNERS)
    whole = _whole(corners)
    if corners.dtype.kind == "u":  # which has no -1
        whole[corners == np.iinfo(corners.dtype).max] = -1
    whole = np.insert(whole, np.cumsum(sizes), -1)
    triangles = strips(whole, whole == -1)
    bounds.check(triangles=len(triangles))
    return triangles


def _lists(element: Element, columns: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertex indices of an element's rows in sequence, and their number in each row."""
    lists = [prop.name for prop in element.properties if prop.count]
    name = next((name for name in _CORNERS if name in lists), lists[0] if len(lists) == 1 else None)
    if name is None:
        raise ValueError(f"its element {element.name} has no list vertex_indices")
    return columns[name]


def _whole(corners: np.ndarray) -> np.ndarray:
    """Return vertex indices as int64."""
    if corners.dtype.kind == "f" and not (np.abs(corners) < 2.0**53).all():
        raise ValueError("a face has a corner that is no number of a vertex")
    whole = corners.astype(np.int64)
    if not (whole == corners).all():
        raise ValueError("a face has a corner that is no whole number")
    return whole
