"""The triangles of a glTF 2.0 scene: nodes place meshes, skins or instances of them, and meshes hold primitives.

Positions may be normalised integers (``KHR_mesh_quantization``) or sparse; triangles may be lists, strips or fans.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vibraverse.contract.texts import counted
from vibraverse.files.reading import extensions
from vibraverse.files.reading.accessors import Accessors
from vibraverse.files.reading.bounds import MAX_PARTS, Bounds
from vibraverse.files.reading.document import Fields
from vibraverse.files.reading.extensions import extension
from vibraverse.files.reading.polygons import Parts, fans, strips
from vibraverse.files.reading.skins import morphed, posed
from vibraverse.geometry import Mesh

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def joined(document: Fields, binary: bytes, bounds: Bounds) -> tuple[Mesh, int, list[str], list[str]]:
    """Return the mesh of a scene in metres, the number of its parts, notes and warnings.

    ``binary`` is the buffer without a URI. A scene without triangles gives its points. Raises ``ValueError`` and
    :class:`TooLarge`.
    """
    warnings = extensions.check(document)
    scene = _Scene(document, binary, bounds)
    parts = scene.parts(_has_triangles)
    count = len(parts)
    if not count:
        parts = scene.parts(_has_points)
    if document.count("scenes") > 1:
        chosen = document.whole("scene", 0)
        warnings.append(f"the file holds {document.count('scenes')} scenes, and scene {chosen} is read.")
    return parts.mesh(), count, scene.notes, warnings


class _Scene:
    """A glTF document whose meshes are read on demand."""

    def __init__(self, document: Fields, binary: bytes, bounds: Bounds):
        self.document, self.bounds = document, bounds
        self.accessors = Accessors(document, binary, bounds)
        self.hidden = 0
        self._read: dict[tuple, Mesh] = {}
        self._worlds: dict[int, np.ndarray] | None = None

    @property
    def notes(self) -> list[str]:
        """What is left out."""
        return [f"left out {counted(self.hidden, 'hidden node')} and what is below"] if self.hidden else []

    def parts(self, wanted) -> Parts:
        """Return the primitives for which ``wanted`` is true, placed."""
        parts = Parts(self.bounds)
        self.hidden = 0
        for node, matrix in self._placed():
            number = node.whole("mesh")
            mesh = self.document.item("meshes", number)
            weights = tuple(_weights(node) or _weights(mesh))
            for index, primitive in enumerate(mesh.items("primitives")):
                if not wanted(primitive):
                    continue
                if (number, index, weights) not in self._read:
                    self._read[number, index, weights] = self._primitive(primitive, weights)
                points, corners = self._read[number, index, weights]
                if "skin" in node and _has_joints(primitive):
                    points, mirrored = self._skinned(primitive, points, node.whole("skin"))
                    parts.add(points, corners[:, ::-1] if mirrored else corners, np.eye(4)[:, :3])
                    continue
                for instance in self._instances(node):
                    parts.add(points, corners, (matrix @ instance)[:3].T)
        return parts

    def _placed(self) -> Iterator[tuple[Fields, np.ndarray]]:
        """Yield the visible nodes with meshes and their transforms (4, 4); of several levels of detail the finest."""
        document, nodes = self.document, self.document.count("nodes")
        if "scenes" in document:
            roots = document.item("scenes", document.whole("scene", 0)).wholes("nodes")
        else:
            children = {child for node in document.items("nodes") for child in node.wholes("children")}
            roots = [number for number in range(nodes) if number not in children]
        coarser = {
            number
            for node in document.items("nodes")
            if (levels := extension(node, extensions.LEVELS))
            for number in levels.wholes("ids")
        }
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
            seen = extension(node, extensions.VISIBILITY)
            if seen is not None and "visible" in seen and not seen.true("visible"):
                self.hidden += 1
                continue
            if number in coarser:
                continue
            matrix = above @ _matrix(node)
            if "mesh" in node:
                yield node, matrix
            pending += [(child, matrix, depth + 1) for child in reversed(node.wholes("children"))]

    def _world(self, number: int) -> np.ndarray:
        """Return the transform (4, 4) of a node in the scene."""
        if self._worlds is None:
            nodes = list(self.document.items("nodes"))
            above = {child: parent for parent, node in enumerate(nodes) for child in node.wholes("children")}
            roots = [(root, np.eye(4)) for root in range(len(nodes)) if root not in above]
            self._worlds = {}
            while roots:
                root, matrix = roots.pop()
                if root in self._worlds:  # a node may be listed twice
                    continue
                self._worlds[root] = matrix = matrix @ _matrix(self.document.item("nodes", root))
                roots += [(child, matrix) for child in nodes[root].wholes("children") if above[child] == root]
        if number not in self._worlds:
            raise ValueError(f"its skin names the joint {number}, which no scene can place")
        return self._worlds[number]

    def _skinned(self, primitive: Fields, points: np.ndarray, number: int) -> tuple[np.ndarray, bool]:
        """Return the vertices of a primitive where the joints of a skin put them, and whether that mirrors it.

        The transform of the node that holds the mesh does not matter (section 3.7.3.3 of the specification).
        """
        skin = self.document.item("skins", number)
        joints = skin.wholes("joints")
        if len(joints) > MAX_PARTS:
            raise ValueError(f"it has a skin of {len(joints)} joints; the limit is {MAX_PARTS}")
        matrices = np.array([self._world(joint) for joint in joints]).reshape(-1, 4, 4)
        if "inverseBindMatrices" in skin:
            inverse = self.accessors.rows(skin.whole("inverseBindMatrices"), "MAT4", zeros=True)
            if len(inverse) < len(joints):
                raise ValueError(f"its skin has {len(joints)} joints and {len(inverse)} matrices")
            # A matrix is stored column by column.
            matrices = matrices @ inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
        attributes, followed, shares = primitive.fields("attributes"), [], []
        while f"JOINTS_{len(followed)}" in attributes and f"WEIGHTS_{len(followed)}" in attributes:
            at = len(followed)
            followed.append(self.accessors.rows(attributes.whole(f"JOINTS_{at}"), "VEC4", zeros=True))
            shares.append(self.accessors.rows(attributes.whole(f"WEIGHTS_{at}"), "VEC4", zeros=True))
            if not len(points) == len(followed[at]) == len(shares[at]):
                raise ValueError(f"its JOINTS_{at} or WEIGHTS_{at} are not as many as its vertices")
        return posed(points, np.hstack(followed), np.hstack(shares), matrices)

    def _instances(self, node: Fields) -> Iterator[np.ndarray]:
        """Yield the transforms (4, 4) of the instances at a node, relative to it."""
        found = extension(node, extensions.INSTANCES)
        if found is None:
            yield np.eye(4)
            return
        attributes = found.fields("attributes")
        rows = {
            name.lower(): self.accessors.rows(attributes.whole(name), type_, zeros=True)
            for name, type_ in (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3"))
            if name in attributes
        }
        counts = {len(values) for values in rows.values()}
        if len(counts) > 1:
            raise ValueError(f"its {node.where} has instances of different numbers")
        for at in range(counts.pop() if counts else 1):
            yield _composed(**{name: values[at].astype(np.float64) for name, values in rows.items()})

    def _primitive(self, primitive: Fields, weights: tuple[float, ...]) -> Mesh:
        """Return vertices, displaced by morph targets, and triangles of a primitive."""
        attributes = primitive.fields("attributes")
        packed = extension(primitive, extensions.DRACO)
        if packed is not None and not self.accessors.has_data(attributes.whole("POSITION")):
            raise extensions.compressed(extensions.DRACO)
        points = self.accessors.rows(attributes.whole("POSITION"), "VEC3").astype(np.float64)
        if any(weights):
            targets = list(primitive.items("targets"))[: len(weights)]
            moves = [
                (self.accessors.rows(target.whole("POSITION"), "VEC3", zeros=True), weight)
                for target, weight in zip(targets, weights, strict=False)
                if weight and "POSITION" in target
            ]
            points = morphed(points, *map(list, zip(*moves, strict=True))) if moves else points
        return points, self._corners(primitive, len(points)) if _has_triangles(primitive) else _NONE

    def _corners(self, primitive: Fields, count: int) -> np.ndarray:
        """Return the triangles (F, 3) of a primitive with ``count`` vertices."""
        mode, ends = primitive.whole("mode", _TRIANGLES), None
        if "indices" in primitive:
            rows = self.accessors.rows(primitive.whole("indices"), "SCALAR")[:, 0]
            if rows.dtype.kind == "f":
                raise ValueError("its indices are not whole numbers")
            corners = rows.astype(np.int64)
            if mode != _TRIANGLES and extensions.RESTART in self.document.texts("extensionsUsed"):
                ends = corners == np.iinfo(rows.dtype).max
        else:
            corners = np.arange(count, dtype=np.int64)
        inside = corners if ends is None else corners[~ends]
        if len(inside) and (inside.min() < 0 or inside.max() >= count):
            raise ValueError(f"a triangle is at vertex {inside.max()} of a part with {count} vertices")
        if mode != _TRIANGLES:
            return fans(corners, ends) if mode == _FAN else strips(corners, ends)
        if len(corners) % 3:
            raise ValueError(f"a part has {len(corners)} corners, which make no triangles")
        return corners.reshape(-1, 3)


_NONE = np.zeros((0, 3), np.int64)


def _has_points(primitive: Fields) -> bool:
    return "attributes" in primitive and "POSITION" in primitive.fields("attributes")


def _has_triangles(primitive: Fields) -> bool:
    return primitive.whole("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN) and _has_points(primitive)


def _has_joints(primitive: Fields) -> bool:
    attributes = primitive.fields("attributes")
    return "JOINTS_0" in attributes and "WEIGHTS_0" in attributes


def _weights(place: Fields) -> list[float]:
    """Return the weights of morph targets at a node or a mesh."""
    return place.numbers("weights", place.count("weights")) if "weights" in place else []


def _matrix(node: Fields) -> np.ndarray:
    """Return the transform (4, 4) of a node: its matrix, or its scale, rotation and translation in this order."""
    if "matrix" in node:
        return np.array(node.numbers("matrix", 16)).reshape(4, 4).T
    counts = {"translation": 3, "rotation": 4, "scale": 3}
    return _composed(**{name: np.array(node.numbers(name, n)) for name, n in counts.items() if name in node})


def _composed(
    translation: np.ndarray | None = None, rotation: np.ndarray | None = None, scale: np.ndarray | None = None
) -> np.ndarray:
    """Return the transform (4, 4) that scales, then turns by the quaternion ``rotation`` (x, y, z, w), then moves."""
    matrix = np.eye(4)
    if rotation is not None:
        x, y, z, w = rotation / np.linalg.norm(rotation)
        matrix[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    if scale is not None:
        matrix[:3, :3] *= scale
    if translation is not None:
        matrix[:3, 3] = translation
    return matrix
