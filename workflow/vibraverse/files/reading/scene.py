"""The triangles of a glTF 2.0 scene: nodes place meshes, primitives index accessors, accessors view buffers.

Positions may be normalised integers (``KHR_mesh_quantization``) or sparse; triangles may be lists, strips or fans.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vibraverse.files.reading.bounds import MAX_PARTS, Bounds
from vibraverse.files.reading.document import Fields, data_uri
from vibraverse.files.reading.polygons import Parts
from vibraverse.geometry import Mesh

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COLUMNS = {"SCALAR": 1, "VEC3": 3}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def joined(document: Fields, binary: bytes, bounds: Bounds) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Return the vertices (V, 3) in metres, triangles (F, 3), metres per unit and number of parts of a scene.

    ``binary`` is the buffer without a URI. Raises ``ValueError`` and :class:`TooLarge`.
    """
    for extension in document.texts("extensionsRequired"):
        if "compression" in extension:
            raise ValueError(f"it is compressed with {extension}, which is not supported")
        if "instancing" in extension:
            raise ValueError(f"it places its parts with {extension}, which is not supported")
    scene, parts = _Scene(document, binary, bounds), Parts(bounds)
    for mesh, matrix in scene.placed():
        for points, corners in scene.primitives(mesh):
            parts.add(points, corners, matrix[:3].T)
    return *parts.mesh(), 1.0, len(parts)


class _Scene:
    """A glTF document whose buffers and meshes are read on demand."""

    def __init__(self, document: Fields, binary: bytes, bounds: Bounds):
        self.document, self.binary, self.bounds = document, binary, bounds
        self._buffers: dict[int, bytes] = {}
        self._read: dict[int, list[Mesh]] = {}

    def placed(self) -> Iterator[tuple[int, np.ndarray]]:
        """Yield the numbers of meshes with their transforms (4, 4)."""
        document, nodes = self.document, self.document.count("nodes")
        if "scenes" in document:
            roots = document.item("scenes", document.whole("scene", 0)).wholes("nodes")
        else:
            children = {child for node in document.items("nodes") for child in node.wholes("children")}
            roots = [number for number in range(nodes) if number not in children]
        pending = [(root, np.eye(4), 1) for root in reversed(roots)]
        visits = 0
        while pending:
            number, above, depth = pending.pop()
            visits += 1
            node = document.item("nodes", number)
            if depth > nodes:
                raise ValueError("its nodes refer to each other in a circle")
            if visits > MAX_PARTS:
                raise ValueError(f"it places more than {MAX_PARTS} nodes")
            matrix = above @ _matrix(node)
            if "mesh" in node:
                yield node.whole("mesh"), matrix
            pending += [(child, matrix, depth + 1) for child in reversed(node.wholes("children"))]

    def primitives(self, number: int) -> list[Mesh]:
        """Return vertices and triangles of all primitives of a mesh that have triangles."""
        if number not in self._read:
            primitives = self.document.item("meshes", number).items("primitives")
            self._read[number] = [self._primitive(one) for one in primitives if _has_triangles(one)]
        return self._read[number]

    def _primitive(self, primitive: Fields) -> Mesh:
        mode = primitive.whole("mode", _TRIANGLES)
        points = self.accessor(primitive.fields("attributes").whole("POSITION"), "VEC3").astype(np.float64)
        if "indices" in primitive:
            corners = self.accessor(primitive.whole("indices"), "SCALAR")[:, 0]
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
        strip[1::2] = strip[1::2][:, [0, 2, 1]]  # every other triangle of a strip is reversed
        return points, strip

    def accessor(self, number: int, type_: str) -> np.ndarray:
        """Return the rows (count, columns) of an accessor."""
        accessor = self.document.item("accessors", number)
        if accessor.text("type") != type_:
            raise ValueError(f"accessors[{number}] is {accessor.text('type'):.20} and should be {type_}")
        count, dtype, columns = accessor.whole("count"), _component(accessor), _COLUMNS[type_]
        if "bufferView" in accessor:
            rows = self._view(accessor, dtype, columns, count)
            self._check(type_, count)
        elif "sparse" in accessor:
            self._check(type_, count)
            rows = np.zeros((count, columns), dtype)
        else:
            raise ValueError(f"accessors[{number}] has no data; the mesh may be compressed")
        if "sparse" in accessor:
            rows = self._changed(rows, accessor.fields("sparse"))
        if accessor.true("normalized") and dtype.kind in "iu":
            rows = np.maximum(rows / np.iinfo(dtype).max, -1.0)
        return rows

    def _changed(self, rows: np.ndarray, sparse: Fields) -> np.ndarray:
        """Return the rows of an accessor with the replacements of its ``sparse``."""
        changes, places = sparse.whole("count"), sparse.fields("indices")
        at = self._view(places, _component(places), 1, changes)[:, 0]
        if len(at) and (at.dtype.kind != "u" or at.max() >= len(rows)):
            raise ValueError(f"its {sparse.where} has indices beyond its {len(rows)} rows")
        rows = rows.copy()
        rows[at] = self._view(sparse.fields("values"), rows.dtype, rows.shape[1], changes)
        return rows

    def _check(self, type_: str, count: int) -> None:
        """Raise :class:`TooLarge` for more positions or indices than the limits allow."""
        if type_ == "VEC3":
            self.bounds.check(vertices=count)
        else:
            self.bounds.check(triangles=count // 3)

    def _view(self, place: Fields, dtype: np.dtype, columns: int, count: int) -> np.ndarray:
        """Return the numbers (count, columns) of a buffer view, without a copy."""
        view = self.document.item("bufferViews", place.whole("bufferView"))
        buffer = self._buffer(view.whole("buffer"))
        begin = view.whole("byteOffset", 0)
        end = begin + view.whole("byteLength")
        begin += place.whole("byteOffset", 0)
        row = dtype.itemsize * columns
        stride = view.whole("byteStride", 0) or row
        needed = (count - 1) * stride + row if count else 0
        if begin + needed > min(end, len(buffer)):
            raise ValueError("an accessor reaches beyond its buffer: the file seems cut off")
        if count < 2:  # the stride is unused, so it may have any value
            stride = row
        return np.ndarray((count, columns), dtype, buffer, begin if count else 0, (stride, dtype.itemsize))

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            buffer = self.document.item("buffers", number)
            self._buffers[number] = data_uri(buffer.text("uri")) if "uri" in buffer else self.binary
        return self._buffers[number]


def _has_triangles(primitive: Fields) -> bool:
    if primitive.whole("mode", _TRIANGLES) not in (_TRIANGLES, _STRIP, _FAN):
        return False
    return "attributes" in primitive and "POSITION" in primitive.fields("attributes")


def _component(accessor: Fields) -> np.dtype:
    """Return the type of the numbers of an accessor."""
    number = accessor.whole("componentType")
    if number not in _COMPONENTS:
        raise ValueError(f"its {accessor.where}.componentType is {number}, which glTF does not know")
    return np.dtype(_COMPONENTS[number])


def _matrix(node: Fields) -> np.ndarray:
    """Return the transform (4, 4) of a node: its matrix, or its scale, rotation and translation in this order."""
    if "matrix" in node:
        return np.array(node.numbers("matrix", 16)).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        turn = np.array(node.numbers("rotation", 4))
        x, y, z, w = turn / np.linalg.norm(turn)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    if "scale" in node:
        matrix[:3, :3] *= np.array(node.numbers("scale", 3))
    if "translation" in node:
        matrix[:3, 3] = node.numbers("translation", 3)
    return matrix
