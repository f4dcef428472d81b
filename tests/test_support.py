"""What changes geometry in each format: a file for every row of the table of what is read, and what comes of it."""

from __future__ import annotations

import base64
import io
import json
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest

import shapes
from mesh_bytes import CORNERS, SIDES, obj, off, ply, stl_text, threemf_text
from mesh_bytes import gltf as tetrahedra
from vibraverse.contract.errors import Refused
from vibraverse.files.meshes import read_mesh
from vibraverse.files.opening import as_one_file
from vibraverse.files.support import LEFT_OUT, READ, REFUSED, TABLE, WARNED

MAKERS = {}


def row(formats: str, feature: str):
    """Register a function that returns files for a row: name, content and what must come of each."""

    def register(maker):
        MAKERS[formats, feature] = maker
        return maker

    return register


def volume(mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


class Gltf:
    """A glTF document built up array by array."""

    def __init__(self, **top):
        self.document = {
            "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [],
            "accessors": [], "bufferViews": [], **top,
        }  # fmt: skip
        self.data = b""

    def accessor(self, array, type_: str = "VEC3", **more) -> int:
        array = np.ascontiguousarray(array)
        kinds = {"|u1": 5121, "<u2": 5123, "<u4": 5125, "<f4": 5126, "<i2": 5122}
        self.data += b"\0" * (-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes}
        self.data += array.tobytes()
        self.document["bufferViews"].append(view)
        self.document["accessors"].append(
            {
                "bufferView": len(self.document["bufferViews"]) - 1,
                "componentType": kinds[array.dtype.str],
                "count": len(array),
                "type": type_,
                **more,
            }
        )
        return len(self.document["accessors"]) - 1

    def mesh(self, points=CORNERS, triangles=SIDES, attributes=None, **primitive) -> int:
        used = {"POSITION": self.accessor(np.asarray(points, "<f4")), **(attributes or {})}
        if triangles is not None:
            primitive["indices"] = self.accessor(np.asarray(triangles, "<u2").ravel(), "SCALAR")
        self.document["meshes"].append({"primitives": [{"attributes": used, **primitive}]})
        return len(self.document["meshes"]) - 1

    def bytes(self) -> bytes:
        uri = "data:application/octet-stream;base64," + base64.b64encode(self.data).decode()
        self.document["buffers"] = [{"byteLength": len(self.data), "uri": uri}]
        return json.dumps(self.document).encode()


def package(text: str, **parts: str) -> bytes:
    """Return a 3MF of a model and further parts, by their names with ``__`` for slashes and ``_dot_`` for dots."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("3D/3dmodel.model", text)
        for name, content in parts.items():
            archive.writestr(name.replace("__", "/").replace("_dot_", "."), content)
    return buffer.getvalue()


def mesh_xml(*meshes) -> str:
    points, triangles = shapes.together(*meshes)
    return (
        "<mesh><vertices>" + "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in points)
        + "</vertices><triangles>" + "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles)
        + "</triangles></mesh>"
    )  # fmt: skip


def model(objects: str, items: str = '<item objectid="1"/>', attributes: str = "") -> str:
    return (
        f'<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" {attributes}>'
        f"<resources>{objects}</resources><build>{items}</build></model>"
    )


def object_xml(number: int, *meshes, more: str = "", type_: str = "model") -> str:
    return f'<object id="{number}" type="{type_}">{mesh_xml(*meshes)}{more}</object>'


BAR = shapes.box((100, 20, 10))
#: Takes the upper half of the bar away over 60 of its 100 mm: 60 · 20 · 5 of 20,000 mm³.
CUTTER = shapes.box((60, 40, 40), centre=(0, 0, 20))
NOTCHED = 14_000


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


@row("GLB, glTF", "triangle lists, strips and fans")
def _():
    file = Gltf()
    file.mesh()
    yield "a.gltf", file.bytes(), 1 / 6
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    end = 0xFFFF
    for mode, order in ((5, [0, 1, 3, 2, end, 0, 1, 2]), (6, [0, 1, 2, 3, end, 0, 1, 2])):
        file = Gltf(extensionsUsed=["KHR_mesh_primitive_restart"])
        file.mesh(square, order, mode=mode)
        yield "a.gltf", file.bytes(), lambda mesh: areas(mesh) == [0.5, 0.5, 0.5]


def areas(mesh) -> list[float]:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return (np.cross(b - a, c - a)[:, 2] / 2).tolist()


@row("GLB, glTF", "points and lines")
def _():
    for mode in (0, 1, 2, 3):
        file = Gltf()
        file.mesh()
        file.mesh(CORNERS + 9, None, mode=mode)
        file.document["meshes"][0]["primitives"] += file.document["meshes"].pop()["primitives"]
        yield "a.gltf", file.bytes(), 1 / 6
        file = Gltf()
        file.mesh(CORNERS, None, mode=mode)
        yield "a.gltf", file.bytes(), "holds 4 points and no triangles", "reconstruct"


@row("GLB, glTF", "sparse accessors, `KHR_mesh_quantization`")
def _():
    file = Gltf(extensionsUsed=["KHR_mesh_quantization"], extensionsRequired=["KHR_mesh_quantization"])
    file.mesh()
    shorts = file.accessor((CORNERS * 32767).astype("<i2"), normalized=True)
    at, moved = (
        file.accessor(np.array([3], "|u1"), "SCALAR"),
        file.accessor(np.array([[0, 0, 2 * 8192]], "<i2")),
    )
    views = [file.document["accessors"][number]["bufferView"] for number in (at, moved)]
    file.document["accessors"][shorts]["sparse"] = {
        "count": 1, "indices": {"bufferView": views[0], "componentType": 5121}, "values": {"bufferView": views[1]}
    }  # fmt: skip
    file.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = shorts
    yield "a.gltf", file.bytes(), 1 / 12


def skinned(joints: list[dict], follow, shares, inverse=None, node=None) -> bytes:
    """Return a tetrahedron that follows joints, whose node a parent would enlarge a hundredfold."""
    file = Gltf()
    attributes = {
        "JOINTS_0": file.accessor(np.asarray(follow, "|u1"), "VEC4"),
        "WEIGHTS_0": file.accessor(np.asarray(shares, "<f4"), "VEC4"),
    }
    file.mesh(attributes=attributes)
    file.document["nodes"] = [
        {"scale": [100, 100, 100], "children": [1]}, {"mesh": 0, "skin": 0, **(node or {})}, *joints
    ]  # fmt: skip
    skin = {"joints": list(range(2, 2 + len(joints)))}
    if inverse is not None:
        skin["inverseBindMatrices"] = file.accessor(
            np.asarray(inverse, "<f4").transpose(0, 2, 1).reshape(-1, 16), "MAT4"
        )
    file.document["skins"] = [skin]
    file.document["scenes"][0]["nodes"] = [0, 2]
    return file.bytes()


@row("GLB, glTF", "skins")
def _():
    first, one = np.zeros((4, 4), int), np.eye(4)[[0] * 4]
    yield "a.gltf", skinned([{"name": "joint"}], first, one), 1 / 6
    yield "a.gltf", skinned([{"scale": [2, 2, 2]}], first, one), 8 / 6
    yield "a.gltf", skinned([{"scale": [2, 2, 2]}], first, one, [np.diag([0.5, 0.5, 0.5, 1])]), 1 / 6
    yield "a.gltf", skinned([{"scale": [-1, 1, 1]}], first, one), 1 / 6  # mirrored, its outside still outside
    yield "a.gltf", skinned([{}], first, np.zeros((4, 4))), 1 / 6  # without weights
    # The tip follows the second joint by half, a child of the first that lies 2 above it: it moves up by (2 + 0) / 2.
    follow, shares = np.array([[0, 1, 0, 0]] * 4), np.array([[1, 0, 0, 0]] * 3 + [[0.5, 0.5, 0, 0]])
    joints = [{"children": [3]}, {"translation": [0, 0, 2]}]
    yield "a.gltf", skinned(joints, follow, shares), 2 / 6


@row("GLB, glTF", "morph targets")
def _():
    for place in ("meshes", "nodes"):
        file = Gltf()
        file.mesh()
        higher = file.accessor(np.array([[0, 0, 0]] * 3 + [[0, 0, 2]], "<f4"))
        file.document["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": higher}, {"NORMAL": higher}]
        file.document["meshes"][0]["weights"] = [0.25, 1]
        file.document[place][0]["weights"] = [0.5, 1]
        yield "a.gltf", file.bytes(), 2 / 6
    del file.document["meshes"][0]["weights"], file.document["nodes"][0]["weights"]
    yield "a.gltf", file.bytes(), 1 / 6


@row("GLB, glTF", "animations")
def _():
    file = Gltf()
    file.mesh()
    times = file.accessor(np.array([0], "<f4"), "SCALAR")
    scale = file.accessor(np.array([[9, 9, 9]], "<f4"))
    file.document["animations"] = [
        {
            "samplers": [{"input": times, "output": scale}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "scale"}}],
        }
    ]
    yield "a.gltf", file.bytes(), 1 / 6


def with_instances(**required) -> bytes:
    file = Gltf(extensionsUsed=["EXT_mesh_gpu_instancing"], **required)
    file.mesh()
    attributes = {
        "TRANSLATION": file.accessor(np.array([[0, 0, 0], [5, 0, 0], [9, 0, 0]], "<f4")),
        "SCALE": file.accessor(np.array([[1, 1, 1], [2, 2, 2], [1, 1, 3]], "<f4")),
        "ROTATION": file.accessor(np.array([[0, 0, 0, 1], [0, 0, 0, 1], [0, 1, 0, 0]], "<f4"), "VEC4"),
    }
    file.document["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    return file.bytes()


@row("GLB, glTF", "instances (`EXT_mesh_gpu_instancing`)")
def _():
    yield "a.gltf", with_instances(), (1 + 8 + 3) / 6
    yield "a.gltf", with_instances(extensionsRequired=["EXT_mesh_gpu_instancing"]), (1 + 8 + 3) / 6
    # Half a turn about y takes the third one, 3 high, below.
    yield "a.gltf", with_instances(), lambda mesh: mesh.vertices[:, 2].min() == pytest.approx(-3)


@row("GLB, glTF", "levels of detail (`MSFT_lod`)")
def _():
    file = Gltf(extensionsUsed=["MSFT_lod"])
    file.mesh()
    file.mesh(CORNERS * 2)
    file.document["nodes"] = [{"mesh": 0, "extensions": {"MSFT_lod": {"ids": [1]}}}, {"mesh": 1}]
    yield "a.gltf", file.bytes(), 1 / 6
    file.document["scenes"][0]["nodes"] = [0, 1]
    yield "a.gltf", file.bytes(), 1 / 6


@row("GLB, glTF", "hidden nodes (`KHR_node_visibility`)")
def _():
    file = Gltf(extensionsUsed=["KHR_node_visibility"])
    file.mesh()
    hidden = {"children": [2], "extensions": {"KHR_node_visibility": {"visible": False}}}
    file.document["nodes"] = [{"mesh": 0, "extensions": {"KHR_node_visibility": {}}}, hidden, {"mesh": 0}]
    file.document["scenes"][0]["nodes"] = [0, 1]
    yield "a.gltf", file.bytes(), 1 / 6, "left out 1 hidden node"


@row("GLB, glTF", "several scenes")
def _():
    for scene, solid in ((None, 1 / 6), (1, 8 / 6)):
        file = Gltf(scene=scene, scenes=[{"nodes": [0]}, {"nodes": [1]}], nodes=[{"mesh": 0}, {"mesh": 1}])
        file.mesh()
        file.mesh(CORNERS * 2)
        yield "a.gltf", file.bytes(), solid, f"the file holds 2 scenes, and scene {scene or 0} is read"


def packed(name: str, plain: bool, required: bool) -> bytes:
    """Return a tetrahedron with an extension that compresses it, with or without the plain data."""
    file = Gltf(extensionsUsed=[name], **({"extensionsRequired": [name]} if required else {}))
    file.mesh()
    if name == "KHR_draco_mesh_compression":
        file.document["meshes"][0]["primitives"][0]["extensions"] = {
            name: {"bufferView": 0, "attributes": {}}
        }
        if not plain:
            for accessor in file.document["accessors"]:
                del accessor["bufferView"]
        return file.bytes()
    document = json.loads(file.bytes())
    for view in document["bufferViews"]:
        view["extensions"] = {
            name: {"buffer": 0, "byteLength": 4, "byteStride": 4, "count": 1, "mode": "TRIANGLES"}
        }
    document["buffers"][0]["extensions"] = {name: {"fallback": True}}
    if not plain:
        del document["buffers"][0]["uri"]
    return json.dumps(document).encode()


COMPRESSIONS = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")


@row("GLB, glTF", "optional compression with plain data beside it")
def _():
    for name in COMPRESSIONS:
        yield "a.gltf", packed(name, plain=True, required=False), 1 / 6


@row("GLB, glTF", "Draco and meshopt compression")
def _():
    for name in COMPRESSIONS:
        for required in (True, False):
            said = f"compressed with {name}"
            yield "a.gltf", packed(name, plain=False, required=required), said, "without mesh compression"


@row("GLB, glTF", "unknown extensions that the file requires")
def _():
    file = Gltf(extensionsRequired=["ACME_bulge"])
    file.mesh()
    yield "a.gltf", file.bytes(), 1 / 6, "requires the glTF extension ACME_bulge"
    shapeless = ["KHR_texture_transform", "KHR_materials_unlit", "EXT_texture_webp", "KHR_lights_punctual"]
    file.document |= {"extensionsRequired": shapeless, "extensionsUsed": ["ACME_bulge"]}
    yield "a.gltf", file.bytes(), lambda mesh: mesh.warnings == ()


@row("GLB, glTF", "version 1.0")
def _():
    old = {"scenes": {"s": {"nodes": ["n"]}}, "nodes": {"n": {"meshes": ["m"]}}, "meshes": {}, "buffers": {}}
    for document in ({"asset": {"version": "1.0"}, **old}, old):
        yield "a.gltf", json.dumps(document).encode(), "it is glTF version 1.0, and only", "as glTF 2.0"
    yield (
        "a.glb",
        b"glTF\1\0\0\0\x20\0\0\0\x04\0\0\0\0\0\0\0{}  ",
        "it is glTF version 1, and only",
        "as glTF 2.0",
    )


@row("3MF", "build items, components, transforms, units")
def _():
    yield "a.3mf", package(threemf_text("inch")), lambda mesh: (mesh.unit_m, mesh.parts) == (0.0254, 2)
    yield "a.3mf", package(threemf_text("inch")), 16 / 6


@row("3MF", "models in parts of their own (production extension)")
def _():
    root = model(
        '<object id="9" type="model"><components><component p:path="/3D/Objects/o.model" objectid="1" '
        'transform="1 0 0 0 1 0 0 0 2 0 0 0"/></components></object>',
        '<item objectid="9"/>',
        'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" requiredextensions="p"',
    )
    part = model(object_xml(1, BAR), "")
    yield "a.3mf", package(root, **{"3D__Objects__o_dot_model": part}), 40_000
    # The start part is the one that the package names, whatever its name and place.
    relationships = (
        '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="r" '
        'Target="/3D/root.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
    )
    parts = {"3D__Objects__o_dot_model": part, "3D__root_dot_model": root, "_rels__dot_rels": relationships}
    parts["_rels/.rels"] = parts.pop("_rels__dot_rels")
    yield "a.3mf", package(model(object_xml(1, CUTTER)), **parts), 40_000


@row("3MF", "objects of type `model` and `surface`")
def _():
    for type_ in ("model", "surface"):
        yield "a.3mf", package(model(object_xml(1, BAR, type_=type_))), 20_000


@row("3MF", "objects of type `support`, `solidsupport`, `other`")
def _():
    for type_ in ("support", "solidsupport", "other"):
        both = object_xml(1, BAR) + object_xml(2, CUTTER, type_=type_)
        said = f"left out 1 object of type {type_}"
        yield "a.3mf", package(model(both, '<item objectid="1"/><item objectid="2"/>')), 20_000, said
        parts = '<component objectid="1"/><component objectid="2"/>'
        whole = f'<object id="3" type="model"><components>{parts}</components></object>'
        yield "a.3mf", package(model(both + whole, '<item objectid="3"/>')), 20_000, said
    alone = package(model(object_xml(1, BAR, type_="support")))
    yield "a.3mf", alone, "holds no vertices (left out 1 object of type support)", "Export it again"


@row("3MF", 'items that are not printed (`printable="0"`)')
def _():
    items = '<item objectid="1" printable="1"/><item objectid="2" printable="0"/>'
    both = package(model(object_xml(1, BAR) + object_xml(2, CUTTER), items))
    yield "a.3mf", both, 20_000, "left out 1 object that is not printed"


def prusa(*volumes: tuple[str, str]) -> dict[str, str]:
    """Return the settings that give a key and a value to each twelve triangles of object 1."""
    text = "".join(
        f'<volume firstid="{12 * at}" lastid="{12 * at + 11}"><metadata type="volume" key="{key}" value="{value}"/></volume>'
        for at, (key, value) in enumerate(volumes)
    )
    return {"Metadata__Slic3r_PE_model_dot_config": f'<config><object id="1">{text}</object></config>'}


def bambu(kind: str) -> tuple[str, dict[str, str]]:
    """Return a model of two components, and the settings that name the kind of the second."""
    both = object_xml(1, BAR) + object_xml(2, CUTTER, type_="model" if kind == "normal_part" else "other")
    whole = '<object id="3" type="model"><components><component objectid="1"/><component objectid="2"/></components></object>'
    parts = f'<part id="1" subtype="normal_part"/><part id="2" subtype="{kind}"/>'
    config = f'<config><object id="3">{parts}</object></config>'
    return model(both + whole, '<item objectid="3" transform="1 0 0 0 1 0 0 0 1 50 50 5"/>'), {
        "Metadata__model_settings_dot_config": config
    }


@row("3MF", "negative volumes of slicers")
def _():
    two = model(object_xml(1, BAR, CUTTER))
    said = "subtracted 1 negative volume"
    roles = (("volume_type", "ModelPart"), ("volume_type", "NegativeVolume"))
    yield "a.3mf", package(two, **prusa(*roles)), NOTCHED, said
    yield (
        "a.3mf",
        package(two, **prusa(*roles)),
        lambda mesh: np.ptp(mesh.vertices, axis=0).tolist() == [100, 20, 10],
    )
    text, config = bambu("negative_part")
    yield "a.3mf", package(text, **config), NOTCHED, said
    open_bar = (BAR[0], BAR[1][1:])
    damaged = package(model(object_xml(1, open_bar, CUTTER)), **{
        "Metadata__Slic3r_PE_model_dot_config": '<config><object id="1"><volume firstid="11" lastid="22">'
        '<metadata key="volume_type" value="NegativeVolume"/></volume></object></config>'
    })  # fmt: skip
    yield "a.3mf", damaged, "a negative volume, which cannot be subtracted", "mesh editor"


@row("3MF", "modifiers, support blockers and enforcers of slicers")
def _():
    two, said = model(object_xml(1, BAR, CUTTER)), "left out 1 modifier of a slicer"
    part = ("volume_type", "ModelPart")
    for other in (
        *(("volume_type", kind) for kind in ("ParameterModifier", "SupportEnforcer", "SupportBlocker")),
        ("modifier", "1"),
    ):
        yield "a.3mf", package(two, **prusa(part, other)), 20_000, said
    for kind in ("modifier_part", "support_enforcer", "support_blocker"):
        text, config = bambu(kind)
        yield "a.3mf", package(text, **config), 20_000, said
    inside = '<s:volumes><s:volume ts="0" te="11" modifier="0"/><s:volume ts="12" te="23" modifier="1"/></s:volumes>'
    text = model(object_xml(1, BAR, CUTTER).replace("</mesh>", f"{inside}</mesh>"), attributes='xmlns:s="s"')
    yield "a.3mf", package(text), 20_000, said
    text, config = bambu("normal_part")
    yield "a.3mf", package(text, **config), 20_000 + 60 * 40 * 40
    broken = package(two, Metadata__model_settings_dot_config="<config>")
    yield "a.3mf", broken, 20_000 + 60 * 40 * 40, "settings metadata/model_settings.config cannot be read"


BEAMS = (
    '<b:beamlattice radius="4" minlength="0.001"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice>'
)


@row("3MF", "beam lattices")
def _():
    lattice = object_xml(1, BAR).replace("</mesh>", f"{BEAMS}</mesh>")
    text = model(
        lattice, attributes='xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"'
    )
    yield "a.3mf", package(text), "its object 1 is a beam lattice, which is not read", "mesh of triangles"


@row("3MF", "Boolean shapes, displaced surfaces, level sets, slices")
def _():
    for element, said in (
        ("x:booleanshape", "a Boolean operation"),
        ("x:displacementmesh", "a displaced surface"),
        ("x:levelset", "a level set"),
    ):
        text = model(object_xml(1, BAR, more=f"<{element}/>"), attributes='xmlns:x="x"')
        yield "a.3mf", package(text), said, "mesh of triangles"
    text = object_xml(1, BAR).replace("<object", '<object meshresolution="lowres"')
    yield "a.3mf", package(model(text)), "a stack of slices", "mesh of triangles"


@row("3MF", "encrypted models (secure content)")
def _():
    yield (
        "a.3mf",
        package(model(object_xml(1, BAR)), Secure__keystore_dot_xml="<k/>"),
        "encrypted",
        "encryption",
    )


@row("3MF", "unknown extensions that the file requires")
def _():
    text = model(object_xml(1, BAR), attributes='xmlns:q="http://acme.example/bulge" requiredextensions="q"')
    yield "a.3mf", package(text), 20_000, "requires the 3MF extension http://acme.example/bulge"
    known = 'xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" requiredextensions="m"'
    yield "a.3mf", package(model(object_xml(1, BAR), attributes=known)), lambda mesh: mesh.warnings == ()


def test_every_row_has_its_files():
    assert list(MAKERS) == [(one.formats, one.feature) for one in TABLE]
    assert {one.treatment for one in TABLE} == {READ, LEFT_OUT, WARNED, REFUSED}


@pytest.mark.parametrize("one", TABLE, ids=lambda one: f"{one.formats}: {one.feature}")
def test_what_changes_geometry_is_read_or_named(tmp_path, one):
    """A row is read as said: a volume or a check of the mesh, and a note or warning; or a message and its advice."""
    treated = set()
    for number, (name, content, wanted, *more) in enumerate(MAKERS[one.formats, one.feature]()):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        path.write_bytes(content)
        if isinstance(wanted, str):
            with pytest.raises(Refused) as refused:
                read_mesh(path)
            assert wanted in refused.value.message
            assert more[0] in refused.value.advice
            treated.add(REFUSED)
            continue
        mesh = read_mesh(path)
        if callable(wanted):
            assert wanted(mesh), f"{name} {number}"
        else:
            assert volume(mesh) == pytest.approx(wanted, rel=1e-3), f"{name} {number}"
        said = " ".join([*mesh.notes, *mesh.warnings])
        assert (more[0] if more else "") in said
        treated.add(WARNED if mesh.warnings else READ)
        # The packed copy of a glTF, which the workflow keeps, is read the same.
        key, _ = as_one_file(path, tmp_path / str(number) / "source.mesh")
        copy = read_mesh(tmp_path / str(number) / "source.mesh", key)
        assert np.array_equal(copy.vertices, mesh.vertices)
        assert (copy.notes, copy.warnings) == (mesh.notes, mesh.warnings)
    assert (READ if one.treatment == LEFT_OUT else one.treatment) in treated


def test_the_table_is_in_the_documentation(root):
    text = (root / "docs/own-meshes.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| (.+?) \| (.+?) \| (read|left out|warning|refused)(?:: (.+?))? \|$", text, re.MULTILINE
    )
    assert rows == [tuple(one) for one in TABLE]


def case(folder: Path, name: str):
    (path,) = (path for path in (folder / name).iterdir() if path.name != "EXPECTED.txt")
    return path


def test_cases_of_bug_reports_are_read_right(shared_cases):
    def extent(mesh) -> float:
        return float(np.ptp(mesh.vertices, axis=0).max())

    for name, long_m in (("gltf-skin-node-transform", 0.3), ("gltf-instancing-optional", 0.42)):
        assert extent(read_mesh(case(shared_cases, name))) == pytest.approx(long_m)
    for name, mm3 in (("3mf-support", 20_000), ("3mf-negative-volume", NOTCHED)):
        mesh = read_mesh(case(shared_cases, name))
        assert volume(mesh) == pytest.approx(mm3)
        assert extent(mesh) == pytest.approx(100)
    assert len(read_mesh(case(shared_cases, "obj-utf16")).faces) == 12


@pytest.mark.parametrize(
    ("name", "said", "advice"),
    [
        ("gltf-1.0", "it is glTF version 1.0, and only version 2 is read", "glTF 2.0"),
        ("gltf-draco", "compressed with KHR_draco_mesh_compression", "without mesh compression"),
        ("gltf-points", "8 points and no triangles", "reconstruct"),
        ("3mf-beam-lattice", "a beam lattice", "mesh of triangles"),
    ],
)
def test_cases_of_bug_reports_are_refused_with_fitting_advice(shared_cases, tmp_path, name, said, advice):
    path = case(shared_cases, name)
    with pytest.raises(Refused) as refused:
        read_mesh(path)
    assert said in refused.value.message
    assert advice in refused.value.advice

    def through_the_workflow():
        key, _ = as_one_file(path, tmp_path / "source.mesh")
        read_mesh(tmp_path / "source.mesh", key, path.name)

    with pytest.raises(Refused, match=re.escape(said)):
        through_the_workflow()
