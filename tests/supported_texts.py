"""Files for the rows on OBJ, PLY, STL and OFF, and on texts in every format."""

from __future__ import annotations

import json

import numpy as np

from mesh_bytes import CORNERS, SIDES, obj, off, ply, stl_text
from mesh_bytes import gltf as tetrahedra
from supported import row
from supported_3mf import BAR, model, object_xml, package


@row("all texts", "UTF-16, UTF-32, byte order marks")
def _():
    texts = {
        "a.obj": obj(),
        "a.off": off(),
        "a.ply": ply(),
        "a.stl": stl_text(),
        "a.gltf": json.dumps(tetrahedra()).encode(),
    }
    solid = {"a.stl": 1 / 6, "a.gltf": 2 / 6}
    for name, text in texts.items():
        for encoding in ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig"):
            yield name, text.decode().encode(encoding), solid.get(name, 1.0)
    yield "a.3mf", package(model(object_xml(1, BAR)).encode("utf-16")), 20_000
    xml = '<?xml version="1.0" encoding="UTF-16"?>' + model(object_xml(1, BAR))
    yield "a.3mf", package(xml.encode("utf-16")), 20_000


@row("OBJ, PLY, OFF", "faces with more than three corners")
def _():
    for name, made in (("a.obj", obj()), ("a.ply", ply()), ("a.off", off())):
        yield name, made, 1.0


@row("OBJ", "negative indices, continued lines")
def _():
    text = b"".join(b"v %g %g %g\n" % tuple(v) for v in CORNERS)
    yield "a.obj", text + b"".join(b"f %d \\\n %d %d\n" % tuple(side - 4) for side in SIDES), 1 / 6


@row("OBJ", "points and lines (`p`, `l`)")
def _():
    yield "a.obj", obj() + b"v 9 9 9\np 9\nl 1 9\n", 1.0


FREE_FORM = b"cstype bspline\ndeg 1 1\nsurf 0 1 0 1 1 2 3 4\nparm u 0 0 1 1\nparm v 0 0 1 1\nend\n"


@row("OBJ", "free-form surfaces (`surf`) beside faces")
def _():
    yield "a.obj", obj() + FREE_FORM, 1.0, "1 free-form surfaces (surf) are not read"


@row("OBJ", "free-form surfaces alone")
def _():
    yield "a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n" + FREE_FORM, "free-form surfaces", "polygons"


@row("OBJ", "other files (`call`)")
def _():
    yield "a.obj", obj() + b"call part.obj\n", "includes another file", "one file"


STRIP = [0, 1, 2, 3, -1, 0, 3, 1, -1, 0, 2, 3]  # a tetrahedron's sides in three strips of two, one and one


def strips_ply(form: str, count: str = "int", index: str = "int", rows=(STRIP,)) -> bytes:
    head = f"ply\nformat {form} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element tristrips {len(rows)}\nproperty list {count} {index} vertex_indices\nend_header\n"
    if form == "ascii":
        lines = [*CORNERS.tolist(), *([len(one), *one] for one in rows)]
        return head.encode() + b"".join(" ".join(map(str, line)).encode() + b"\n" for line in lines)
    order = "<" if "little" in form else ">"
    body = CORNERS.astype(f"{order}f4").tobytes()
    for one in rows:
        body += np.array([len(one)], f"{order}i4").tobytes() + np.array(one, f"{order}i4").tobytes()
    return head.encode() + body


@row("PLY", "triangle strips (`tristrips`)")
def _():
    # The strip's first two triangles are (0, 1, 2) and (1, 3, 2); all four face inwards, so the volume is negative.
    for form in ("ascii", "binary_little_endian", "binary_big_endian"):
        yield "a.ply", strips_ply(form), -1 / 6
    yield "a.ply", strips_ply("binary_big_endian", index="uint"), -1 / 6
    yield "a.ply", strips_ply("ascii", rows=[[0, 1, 2, 3], [0, 3, 1], [0, 2, 3]]), -1 / 6


@row("PLY", "edges and other elements")
def _():
    yield "a.ply", ply("binary_little_endian"), 1.0
    yield "a.ply", ply().replace(b"element face", b"element camera 0\nproperty float view\nelement face"), 1.0


@row("PLY", "range grids (`range_grid`)")
def _():
    text = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    text += b"element range_grid 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0\n"
    yield "a.ply", text, "range_grid", "Reconstruct a surface"


@row("STL", "several solids in one file")
def _():
    yield "a.stl", stl_text() + stl_text(CORNERS + 5), 2 / 6


@row("OFF", "normals, colours, texture coordinates")
def _():
    for head in (b"OFF", b"COFF", b"NOFF", b"STCNOFF"):
        yield "a.off", off(head=head), 1.0


@row("OFF", "binary form; points of four or n coordinates")
def _():
    yield "a.off", b"OFF BINARY\n\0\0\0\1", "a binary OFF file", "text OFF"
    for head in (b"4OFF", b"nOFF", b"C4OFF"):
        yield "a.off", off(head=head), f"of the kind {head.decode()}", "three coordinates"
