"""OBJ: positions, and corners of faces; indices start at 1, and negative ones count back from the last vertex."""

from __future__ import annotations

from typing import BinaryIO

from vibraverse.files.formats import Format, MeshData
from vibraverse.files.reading.bounds import Bounds
from vibraverse.files.reading.lines import as_utf8, invalid, joined, lines
from vibraverse.files.reading.mistakes import Unsupported

#: Elements that make a surface from curves or control points.
_FREE_FORM = (b"surf", b"bzp", b"bsp", b"cdp")


def read(file: BinaryIO, bounds: Bounds) -> MeshData:
    """Return the triangles of an OBJ file; faces with fewer than three corners are dropped."""
    from vibraverse.files.reading.polygons import Points, Polygons, triangulate

    points, polygons = Points(bounds), Polygons(bounds)
    free_form = 0
    for number, line in joined(lines(as_utf8(file))):
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
        except ValueError:
            raise invalid(number, line) from None
        if words[0] in _FREE_FORM:
            free_form += 1
        elif words[0] == b"call":
            raise Unsupported(f"its line {number} includes another file", "Export the model as one file.")
    if free_form and not len(polygons.sizes):
        raise Unsupported(
            f"it holds {free_form} free-form surfaces (surf) and no faces", "Export it as a mesh of polygons."
        )
    vertices = points.array()
    warnings = (f"{free_form} free-form surfaces (surf) are not read; export them as polygons.",)
    return MeshData(
        vertices, triangulate(vertices, *polygons.arrays()), warnings=warnings if free_form else ()
    )


FORMAT = Format("OBJ", (".obj",), read)
