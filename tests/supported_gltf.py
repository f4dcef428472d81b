"""Files for the rows on glTF."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest

from mesh_bytes import CORNERS, SIDES
from supported import row


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
