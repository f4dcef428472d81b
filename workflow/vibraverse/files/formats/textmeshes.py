"""Text formats of meshes: OBJ, OFF and the text form of STL, read line by line.

Only what makes the surface is read: positions and the corners of faces. In OBJ indices count from 1, negative
ones backwards from the latest vertex; in OFF from 0. Each parser takes an open binary file and the
:class:`Bounds` of the mesh and raises ``ValueError`` naming what cannot be read, or :class:`TooLarge`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from vibraverse.files.formats.bounds import Bounds
from vibraverse.files.formats.polygons import Points, Polygons, triangulate
from vibraverse.geometry import Mesh

#: No line of a mesh is longer: a polygon of two million corners has less.
_MAX_LINE = 1 << 24


def parse_obj(file: BinaryIO, bounds: Bounds) -> Mesh:
    """Return vertices (V, 3) and triangles (F, 3) of an OBJ file; faces of fewer than three corners are not kept."""
    points, polygons = Points(bounds), Polygons(bounds)
    for number, line in _joined(_lines(file)):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        try:
            if words[0] == b"v":
                x, y, z = words[1:4]
                points.add(float(x), float(y), float(z))
            elif words[0] in (b"f", b"fo") and len(words) > 3:
                corners = [int(word.partition(b"/")[0]) for word in words[1:]]
                if 0 in corners:
                    raise ValueError("vertices count from 1")
                polygons.add([c - 1 if c > 0 else len(points) + c for c in corners])
        except (ValueError, OverflowError):
            raise _wrong(number, line) from None
    vertices = points.array()
    return vertices, triangulate(vertices, *polygons.arrays())


def parse_off(file: BinaryIO, bounds: Bounds) -> Mesh:
    """Return vertices (V, 3) and triangles (F, 3) of a text OFF file, with or without normals, colours, comments.

    Some collections write the counts right behind the keyword.
    """
    rows = _rows(file)
    number, first = next(rows, (1, b""))
    keyword = re.match(rb"(ST)?(C)?(N)?OFF", first)
    if keyword is None:
        raise ValueError("it does not begin with OFF")
    first = first[keyword.end() :].split()
    if first[:1] == [b"BINARY"]:
        raise ValueError("it is a binary OFF file, and only its text form is read")
    if not first:
        number, line = next(rows, (number, b""))
        first = line.split()
    if len(first) < 2:
        raise ValueError("the numbers of vertices and faces are missing")
    try:
        count, faces = int(first[0]), int(first[1])
    except ValueError:
        raise _wrong(number, b" ".join(first)) from None
    start = file.tell()
    if 2 * (count + faces) > file.seek(0, 2):  # a line takes two bytes
        raise ValueError(f"it announces {count} vertices and {faces} faces and is too short for them")
    file.seek(start)
    bounds.check(vertices=count, triangles=faces)
    points, polygons = Points(bounds), Polygons(bounds)
    for done in range(count + faces):
        number, line = next(rows, (0, b""))
        if not number:
            raise ValueError(f"it announces {count} vertices and {faces} faces and ends after {done} of them")
        words = line.split()
        try:
            if done < count:
                x, y, z = words[:3]
                points.add(float(x), float(y), float(z))
            else:
                size = int(words[0])
                corners = [int(word) for word in words[1 : 1 + max(size, 0)]]
                if len(corners) != size:
                    raise ValueError("cut short")
                if size >= 3:
                    polygons.add(corners)
        except (ValueError, OverflowError):
            raise _wrong(number, line) from None
    if count < 0 or faces < 0:
        raise ValueError(f"it announces {count} vertices and {faces} faces")
    vertices = points.array()
    return vertices, triangulate(vertices, *polygons.arrays())


def parse_stl_text(file: BinaryIO, bounds: Bounds) -> Mesh:
    """Return vertices (3F, 3) and triangles (F, 3) of a text STL file."""
    points = Points(bounds)
    facets, closed = 0, True
    for number, line in _lines(file):
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
                raise _wrong(number, line) from None
    if not closed or len(points) != 3 * facets:
        raise ValueError(f"it ends inside a solid, after {facets} triangles, and seems cut off")
    return points.array(), np.arange(len(points), dtype=np.int64).reshape(-1, 3)


def _lines(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield the numbered lines of a text, whatever ends them: \\n, \\r\\n, or \\r alone."""
    start = file.tell()
    head = file.read(1 << 16)
    file.seek(start)
    lines = (
        _returns(file) if b"\r" in head and b"\n" not in head else iter(lambda: file.readline(_MAX_LINE), b"")
    )
    for number, line in enumerate(lines, 1):
        if len(line) >= _MAX_LINE:
            raise ValueError(f"line {number} is longer than {_MAX_LINE >> 20} MB")
        yield number, line


def _returns(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines that \\r alone ends."""
    rest = b""
    while len(rest) < _MAX_LINE and (chunk := file.read(1 << 20)):
        *lines, rest = (rest + chunk).split(b"\r")
        yield from (line + b"\n" for line in lines)
    yield rest


def _joined(lines: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    """Yield lines with those that end with a backslash joined to the next."""
    parts, length = [], 0
    for number, line in lines:
        length += len(line)
        if length > _MAX_LINE:
            raise ValueError(f"line {number} is longer than {_MAX_LINE >> 20} MB")
        if line.endswith((b"\\\n", b"\\\r\n")):
            parts.append(line.rstrip()[:-1] + b" ")
            continue
        yield number, b"".join([*parts, line])
        parts, length = [], 0
    if parts:
        yield number, b"".join(parts)


def _rows(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield the numbered lines that hold more than a comment."""
    for number, line in _lines(file):
        row = line.partition(b"#")[0].strip()
        if row:
            yield number, row


def _wrong(number: int, line: bytes) -> ValueError:
    text = line.strip()[:60].decode("utf-8", "replace")
    return ValueError(f"line {number} is not valid: {text}")
