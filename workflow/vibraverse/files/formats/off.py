"""OFF: a keyword, the numbers of vertices and faces, and a line for each; indices start at 0."""

from __future__ import annotations

import re
from typing import BinaryIO

from vibraverse.files.formats import Format, MeshData
from vibraverse.files.reading.bounds import Bounds
from vibraverse.files.reading.lines import as_utf8, invalid, rows
from vibraverse.files.reading.mistakes import Unsupported

_AS_PLAIN_OFF = "Export it as text OFF with points of three coordinates, or in another format."


def read(file: BinaryIO, bounds: Bounds) -> MeshData:
    """Return the triangles of a text OFF file, with or without normals, colours and comments.

    Some collections write the counts on the line of the keyword.
    """
    from vibraverse.files.reading.polygons import Points, Polygons, triangulate

    file = as_utf8(file)
    found = rows(file)
    count, faces = _counts(found)
    start = file.tell()
    if 2 * (count + faces) > file.seek(0, 2):  # a line takes at least two bytes
        raise ValueError(f"it announces {count} vertices and {faces} faces and is too short for them")
    file.seek(start)
    bounds.check(vertices=count, triangles=faces)
    points, polygons = Points(bounds), Polygons(bounds)
    for done in range(count + faces):
        number, line = next(found, (0, b""))
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
        except ValueError:
            raise invalid(number, line) from None
    vertices = points.array()
    return MeshData(vertices, triangulate(vertices, *polygons.arrays()))


def _counts(found) -> tuple[int, int]:
    """Return the numbers of vertices and faces that the first rows announce."""
    number, first = next(found, (1, b""))
    keyword = re.match(rb"(ST)?(C)?(N)?(4)?(n)?OFF", first)
    if keyword is None:
        raise ValueError("it does not begin with OFF")
    if keyword[4] or keyword[5]:
        raise Unsupported(
            f"it is of the kind {keyword[0].decode()}, whose points have other than three coordinates",
            _AS_PLAIN_OFF,
        )
    words = first[keyword.end() :].split()
    if words[:1] == [b"BINARY"]:
        raise Unsupported("it is a binary OFF file, and only the text form is read", _AS_PLAIN_OFF)
    if not words:
        number, line = next(found, (number, b""))
        words = line.split()
    if len(words) < 2:
        raise ValueError("the numbers of vertices and faces are missing")
    try:
        count, faces = int(words[0]), int(words[1])
    except ValueError:
        raise invalid(number, b" ".join(words)) from None
    if count < 0 or faces < 0:
        raise ValueError(f"it announces {count} vertices and {faces} faces")
    return count, faces


FORMAT = Format("OFF", (".off",), read)
