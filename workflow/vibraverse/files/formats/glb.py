"""The triangles of a GLB (glTF 2.0): nodes place meshes, primitives index accessors, accessors view one buffer.

Positions may be normalised integers (``KHR_mesh_quantization``) or sparse; triangles may be lists, strips or fans.
"""

from __future__ import annotations

import json
import struct
from typing import BinaryIO

import numpy as np

from vibraverse.files.formats.bounds import MAX_PARTS, Bounds
from vibraverse.files.formats.gltf import data_uri
from vibraverse.files.formats.polygons import Parts
from vibraverse.geometry import Mesh

_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC3": 3}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def parse_glb(file: BinaryIO, bounds: Bounds) -> tuple[np.ndarray, np.ndarray, int]:
    """Return vertices (V, 3) in metres, triangles (F, 3) and the number of parts of a GLB.

    Raises ``ValueError`` (or what a wrong type in the JSON raises) and
    :class:`vibraverse.files.formats.bounds.TooLarge`.
    """
    document, binary = _chunks(file)
    for extension in document.get("extensionsRequired", []):
        if "compression" in extension:
            raise ValueError(f"it is compressed with {extension}, which is not supported")
        if "instancing" in extension:
            raise ValueError(f"it places its parts with {extension}, which is not supported")
    scene, parts = _Scene(document, binary, bounds), Parts(bounds)
    for mesh, matrix in scene.placed():
        for points, corners in scene.primitives(mesh):
            parts.add(points, corners, matrix[:3].T)
    return *parts.mesh(), len(parts)


def _chunks(file: BinaryIO) -> tuple[dict, bytes]:
    """Return the JSON document and the binary chunk of a GLB."""
    head = file.read(20)
    if head[:4] != _MAGIC or len(head) < 20:
        raise ValueError("it does not begin like a GLB file")
    version, _, length, kind = struct.unpack_from("<IIII", head, 4)
    if version != 2:
        raise ValueError(f"it is of version {version}, and only version 2 is read")
    if head[16:20] != _JSON:
        raise ValueError("its first chunk is not JSON")
    text = file.read(length)
    if len(text) < length:
        raise ValueError("it ends inside its JSON chunk and seems cut off")
    document = json.loads(text)
    if not isinstance(document, dict):
        raise ValueError("its JSON chunk holds no glTF")
    while len(head := file.read(8)) == 8:
        length, kind = struct.unpack("<I4s", head)
        data = file.read(length)
        if len(data) < length:
            raise ValueError(
                f"it states a chunk of {length} bytes and ends after {len(data)}: it seems cut off"
            )
        if kind == _BIN:
            return document, data
    return document, b""


class _Scene:
    """The document, with what it refers to looked up on demand."""

    def __init__(self, document: dict, binary: bytes, bounds: Bounds):
        self.document, self.binary, self.bounds = document, binary, bounds
        self._buffers: dict[int, bytes] = {}
        self._read: dict[int, list[Mesh]] = {}

    def item(self, kind: str, number) -> dict:
        """Return one entry of a list of the document."""
        entries = self.document.get(kind, [])
        if type(number) is not int or not 0 <= number < len(entries):
            raise ValueError(f"it has no {kind}[{number}]")
        return entries[number]

    def placed(self):
        """Yield mesh numbers with the (4, 4) matrices that place them."""
        nodes = self.document.get("nodes", [])
        if "scenes" in self.document:
            roots = self.item("scenes", self.document.get("scene", 0)).get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [number for number in range(len(nodes)) if number not in children]
        pending = [(root, np.eye(4), 1) for root in reversed(roots)]
        visits = 0
        while pending:
            number, above, depth = pending.pop()
            visits += 1
            if depth > len(nodes):
                raise ValueError("its nodes refer to each other in a circle")
            if visits > MAX_PARTS:
                raise ValueError(f"it places more than {MAX_PARTS} nodes")
            node = self.item("nodes", number)
            matrix = above @ _matrix(node)
            if "mesh" in node:
                yield node["mesh"], matrix
            pending += [(child, matrix, depth + 1) for child in reversed(node.get("children", []))]

    def primitives(self, number: int) -> list[Mesh]:
        """Return vertices and triangles of each primitive of a mesh that has triangles."""
        mesh = self.item("meshes", number)
        if number not in self._read:
            self._read[number] = [
                self._primitive(primitive)
                for primitive in mesh["primitives"]
                if primitive.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)
                and "POSITION" in primitive.get("attributes", {})
            ]
        return self._read[number]

    def _primitive(self, primitive: dict) -> Mesh:
        mode = primitive.get("mode", _TRIANGLES)
        points = self.accessor(primitive["attributes"]["POSITION"], "VEC3").astype(np.float64)
        if "indices" in primitive:
            corners = self.accessor(primitive["indices"], "SCALAR")[:, 0]
            if corners.dtype.kind == "f":
                raise ValueError("its indices are not whole numbers")
            corners = corners.astype(np.int64)
        else:
            corners = np.arange(len(points), dtype=np.int64)
        if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            raise ValueError(f"a triangle is at vertex {corners.max()} of a part with {len(points)} vertices")
        if mode == _TRIANGLES:
            if len(corners) % 3:
                raise ValueError(f"a part has {len(corners)} corners, which make no triangles")
            return points, corners.reshape(-1, 3)
        if len(corners) < 3:
            return points, np.zeros((0, 3), np.int64)
        if mode == _FAN:
            first = np.full(len(corners) - 2, corners[0])
            return points, np.stack([first, corners[1:-1], corners[2:]], axis=1)
        strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        strip[1::2] = strip[1::2][:, [0, 2, 1]]  # every other triangle of a strip runs the other way round
        return points, strip

    def accessor(self, number: int, type_: str) -> np.ndarray:
        """Return an accessor's rows (count, columns)."""
        accessor = self.item("accessors", number)
        if accessor["type"] != type_:
            raise ValueError(f"accessors[{number}] is {accessor['type']} and should be {type_}")
        count = _whole(accessor["count"], f"accessors[{number}].count")
        dtype = np.dtype(_COMPONENTS[accessor["componentType"]])
        if "bufferView" in accessor:
            rows = self._view(accessor, dtype, _COLUMNS[type_], count)
            self._check(type_, count)
        elif "sparse" in accessor:
            self._check(type_, count)
            rows = np.zeros((count, _COLUMNS[type_]), dtype)
        else:
            raise ValueError(f"accessors[{number}] has no data; the mesh may be compressed")
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            changes = _whole(sparse["count"], "sparse.count")
            kind = np.dtype(_COMPONENTS[sparse["indices"]["componentType"]])
            at = self._view(sparse["indices"], kind, 1, changes)[:, 0]
            if len(at) and (at.dtype.kind != "u" or at.max() >= count):
                raise ValueError(f"accessors[{number}] has sparse indices beyond its {count} rows")
            rows = rows.copy()
            rows[at] = self._view(sparse["values"], dtype, _COLUMNS[type_], changes)
        if accessor.get("normalized") and dtype.kind in "iu":
            rows = np.maximum(rows / np.iinfo(dtype).max, -1.0)
        return rows

    def _check(self, type_: str, count: int) -> None:
        """Raise :class:`TooLarge` for more positions or indices than the limits allow."""
        if type_ == "VEC3":
            self.bounds.check(vertices=count)
        else:
            self.bounds.check(triangles=count // 3)

    def _view(self, place: dict, dtype: np.dtype, columns: int, count: int) -> np.ndarray:
        """Return (count, columns) numbers of a buffer view, without a copy."""
        view = self.item("bufferViews", place["bufferView"])
        buffer = self._buffer(view["buffer"])
        begin = _whole(view.get("byteOffset", 0), "byteOffset")
        end = begin + _whole(view["byteLength"], "byteLength")
        begin += _whole(place.get("byteOffset", 0), "byteOffset")
        stride = _whole(view.get("byteStride", 0), "byteStride") or dtype.itemsize * columns
        needed = (count - 1) * stride + dtype.itemsize * columns if count else 0
        if begin + needed > min(end, len(buffer)):
            raise ValueError("an accessor reaches beyond its buffer: the file seems cut off")
        return np.ndarray((count, columns), dtype, buffer, begin if count else 0, (stride, dtype.itemsize))

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            uri = self.item("buffers", number).get("uri")
            if uri is None:
                self._buffers[number] = self.binary
            else:
                self._buffers[number] = data_uri(uri)
        return self._buffers[number]


def _matrix(node: dict) -> np.ndarray:
    """Return the matrix (4, 4) of a node: its own, or its scale, rotation and translation in this order."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        x, y, z, w = np.array(node["rotation"], dtype=np.float64) / np.linalg.norm(node["rotation"])
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    if "scale" in node:
        matrix[:3, :3] *= np.array(node["scale"], dtype=np.float64).reshape(1, 3)
    if "translation" in node:
        matrix[:3, 3] = node["translation"]
    return matrix


def _whole(value, name: str) -> int:
    if type(value) is not int or value < 0:
        raise ValueError(f"its {name} is {value!r:.40}")
    return value
