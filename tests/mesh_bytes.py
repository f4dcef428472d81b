"""Small valid mesh files of every format with known content, and folders of them."""

from __future__ import annotations

import base64
import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np

#: A tetrahedron whose outside is counter-clockwise; its volume is 1/6.
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
SIDES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])

#: The unit cube's corners and its sides as quads; its volume is 1.
CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
QUADS = np.array([[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]])

#: The smallest OBJ with a triangle.
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"

THREEMF = """<?xml version="1.0"?>
<model unit="{unit}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>
<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles></mesh></object>
<object id="2" type="model"><components>
<component objectid="{part}"/><component objectid="1" transform="-1 0 0 0 1 0 0 0 1 -5 0 0"/>
</components></object></resources><build><item objectid="2" transform="2 0 0 0 2 0 0 0 2 10 0 0"/></build></model>"""


def stl(corners=CORNERS, sides=SIDES, header=b"made by a test", count=None, tail=b"") -> bytes:
    """Return a binary STL; ``count`` is what it states."""
    rows = b"".join(
        struct.pack("<3f", 0, 0, 0) + struct.pack("<9f", *corners[side].ravel()) + b"\0\0" for side in sides
    )
    return header.ljust(80, b"\0") + struct.pack("<I", len(sides) if count is None else count) + rows + tail


def stl_text(corners=CORNERS, sides=SIDES) -> bytes:
    """Return a text STL."""
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x} {y} {z}\n" for x, y, z in corners[side])
        + " endloop\nendfacet\n"
        for side in sides
    )
    return f"solid a vertex of fashion\n{facets}endsolid\n".encode()


def ply(form="ascii", vertices=CUBE, polygons=QUADS, extra=True) -> bytes:
    """Return a PLY; ``extra`` adds normals, colours and an element of edges around what is read."""
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
    head = f"ply\nformat {form} 1.0\ncomment a test\nelement vertex {len(vertices)}\n"
    head += "property uchar red\n" * extra + "property float x\nproperty double y\nproperty float z\n"
    head += f"element face {len(polygons)}\nproperty list uchar int vertex_indices\n"
    head += "property list uchar float texcoord\nproperty short group\n" * extra + "end_header\n"
    rows = []
    for x, y, z in vertices:
        numbers = [*[200] * extra, x, y, z]
        rows.append(struct.pack(f"{order}{'B' * extra}fdf", *numbers) if order else _text(numbers))
    for polygon in polygons:
        tail = [2, 0.5, 0.25, 7] if extra else []
        numbers = [len(polygon), *polygon, *tail]
        code = f"{order}B{len(polygon)}i{'Bffh' * extra}"
        rows.append(
            struct.pack(code, *map(int, numbers[: 1 + len(polygon)]), *tail) if order else _text(numbers)
        )
    return head.encode() + b"".join(rows)


def _text(numbers) -> bytes:
    return " ".join(f"{number:g}" for number in numbers).encode() + b"\n"


def off(vertices=CUBE, polygons=QUADS, head=b"COFF") -> bytes:
    """Return a text OFF with comments and colours."""
    lines = [head, b"# a comment", b"%d %d 0" % (len(vertices), len(polygons))]
    lines += [_text([*v, 1, 0, 0, 1]).strip() for v in vertices]
    lines += [_text([len(p), *p, 0, 255, 0]).strip() + b" # side" for p in polygons]
    return b"\n".join(lines) + b"\n"


def obj(vertices=CUBE, polygons=QUADS) -> bytes:
    """Return an OBJ with texture coordinates, groups, a continued line and counts backwards."""
    lines = [b"mtllib a.mtl", b"o cube", *(b"v " + _text(v).strip() for v in vertices), b"vt 0 0"]
    lines += [b"f " + b" ".join(b"%d/1" % (corner + 1) for corner in p) for p in polygons[:-2]]
    lines += [b"g rest", b"f " + b" ".join(b"%d//" % (corner - len(vertices)) for corner in polygons[-2])]
    lines += [b"f \\", b" ".join(b"%d" % (corner + 1) for corner in polygons[-1])]
    return b"\n".join(lines) + b"\n"


def threemf(unit="inch", part=1, text=None, **changes) -> bytes:
    """Return a 3MF of a tetrahedron and its mirror image, scaled by two."""
    if text is None:
        text = threemf_text(unit, part, **changes)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", text)
    return buffer.getvalue()


def threemf_text(unit="inch", part=1, **changes) -> str:
    """Return the model file of :func:`threemf`."""
    vertices = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in CORNERS)
    triangles = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in SIDES)
    return THREEMF.format(unit=unit, part=part, **{"vertices": vertices, "triangles": triangles, **changes})


def gltf_binary() -> bytes:
    """Return the buffer of :func:`gltf`: 12 indices, then 4 positions."""
    return SIDES.astype("<u2").tobytes() + CORNERS.astype("<f4").tobytes()


def gltf(uri: str | None = "data", **extra) -> dict:
    """Return a glTF document that places a tetrahedron and its mirror image; ``uri`` names its buffer."""
    data = gltf_binary()
    if uri == "data":
        uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0, "translation": [3, 0, 0]}, {"mesh": 0, "scale": [-1, 1, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5123, "count": 12, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 24},
            {"buffer": 0, "byteOffset": 24, "byteLength": 48},
        ],
        "buffers": [{"byteLength": len(data), **({"uri": uri} if uri else {})}],
        **extra,
    }


def glb(document: dict | None = None, binary: bytes | None = None) -> bytes:
    """Return a GLB of a document (default: :func:`gltf`) and its binary chunk."""
    text = json.dumps(gltf(uri=None) if document is None else document).encode()
    text += b" " * (-len(text) % 4)
    binary = gltf_binary() if binary is None else binary
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


#: Name -> format and bytes: at least one of every format, and of its dialects.
SAMPLES: dict[str, tuple[str, bytes]] = {
    "obj": ("obj", obj()),
    "stl": ("stl", stl()),
    "stl, solid": ("stl", stl(header=b"solid but binary")),
    "stl, text": ("stl", stl_text()),
    "ply, text": ("ply", ply()),
    "ply, little": ("ply", ply("binary_little_endian")),
    "ply, big": ("ply", ply("binary_big_endian")),
    "ply, mixed": ("ply", ply("binary_little_endian", polygons=[*QUADS[:5], *[[1, 3, 7], [1, 7, 5]]])),
    "ply, mixed text": ("ply", ply(polygons=[*QUADS[:5], *[[1, 3, 7], [1, 7, 5]]])),
    "off": ("off", off()),
    "glb": ("glb", glb()),
    "gltf": ("gltf", json.dumps(gltf()).encode()),
    "3mf": ("3mf", threemf()),
}


def make(folder: Path, *names: str) -> None:
    """Write a triangle under each of these names below a folder."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(TRIANGLE)


def run_sources(vibraverse, folder: Path, object_: str, options: str = "{}", *more):
    """Run the stage ``sources`` into a folder; return exit status, output and errors."""
    outputs = ["--mesh", folder / "source.mesh", "--record", folder / "source.json"]
    return vibraverse("sources", "--object", object_, "--options", options, *outputs, *more)
