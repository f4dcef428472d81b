"""3MF packages to arrays: meshes, components and build items with their transforms.

Implements the geometry of the 3MF core specification 1.3 and the ``path`` attribute of its production
extension, which slicers use to keep each object in a file of its own.
"""

from __future__ import annotations

import io
import zipfile
from xml.etree import ElementTree

import numpy as np

#: Metres per unit, by the model's ``unit`` attribute.
UNITS_M = {
    "micron": 1e-6,
    "millimeter": 1e-3,
    "centimeter": 1e-2,
    "inch": 0.0254,
    "foot": 0.3048,
    "meter": 1.0,
}

_MAX_DEPTH = 32
_MAX_XML_BYTES = 1 << 30


def parse(data: bytes) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Return vertices (V, 3), faces (F, 3), metres per unit and the number of parts of a 3MF package.

    Only what the build section places exists. Raises ``ValueError`` (or what the ZIP and XML readers raise)
    for a package that is not a valid 3MF file.
    """
    package = _Package(zipfile.ZipFile(io.BytesIO(data)))
    root = package.model(package.start)
    scale = _unit_m(root)
    vertices: list[np.ndarray] = []
    faces: list[np.ndarray] = []
    offset = 0
    for item in root.iterfind("{*}build/{*}item"):
        path = _path(item) or package.start
        for points, triangles in package.instances(path, item.get("objectid"), _matrix(item), 0):
            vertices.append(points)
            faces.append(triangles + offset)
            offset += len(points)
    if not vertices:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64), scale, 0
    return np.concatenate(vertices), np.concatenate(faces), scale, len(vertices)


def unit_m(data: bytes) -> float | None:
    """Return the metres per unit that a 3MF package states, or None when it cannot be read."""
    try:
        package = _Package(zipfile.ZipFile(io.BytesIO(data)))
        return _unit_m(package.model(package.start))
    except Exception:  # whatever is wrong with the package is said when its mesh is read
        return None


def _unit_m(root: ElementTree.Element) -> float:
    unit = root.get("unit", "millimeter")
    if unit not in UNITS_M:
        raise ValueError(f"unknown unit {unit!r}")
    return UNITS_M[unit]


class _Package:
    """The model files of a package, parsed once each."""

    def __init__(self, archive: zipfile.ZipFile):
        self.archive = archive
        self.names = {name.lstrip("/").lower(): name for name in archive.namelist()}
        models = [name for name in self.names if name.endswith("3dmodel.model")]
        models = models or [name for name in self.names if name.endswith(".model")]
        if not models:
            raise ValueError("the package holds no 3D model")
        self.start = models[0]
        self._models: dict[str, ElementTree.Element] = {}
        self._meshes: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]] = {}

    def model(self, path: str) -> ElementTree.Element:
        """Return the root element of a model file."""
        key = path.lstrip("/").lower()
        if key not in self._models:
            if key not in self.names:
                raise ValueError(f"the package lacks its part {path}")
            info = self.archive.getinfo(self.names[key])
            if info.file_size > _MAX_XML_BYTES:
                raise ValueError(f"its part {path} is larger than {_MAX_XML_BYTES >> 20} MB")
            self._models[key] = ElementTree.fromstring(self.archive.read(info))
        return self._models[key]

    def instances(self, path: str, number: str | None, matrix: np.ndarray, depth: int):
        """Yield vertices and faces of an object and of its components, placed by ``matrix`` (4, 3)."""
        if depth > _MAX_DEPTH:
            raise ValueError("its components refer to each other in a circle")
        objects = self.model(path).iterfind("{*}resources/{*}object")
        found = next((element for element in objects if element.get("id") == number), None)
        if found is None:
            raise ValueError(f"there is no object {number}")
        mesh = found.find("{*}mesh")
        if mesh is not None:
            points, triangles = self._mesh(path, number, mesh)
            placed = points @ matrix[:3] + matrix[3]
            yield placed, triangles[:, ::-1] if np.linalg.det(matrix[:3]) < 0 else triangles
        for part in found.iterfind("{*}components/{*}component"):
            inner = _matrix(part)
            joined = np.vstack([inner[:3] @ matrix[:3], inner[3] @ matrix[:3] + matrix[3]])
            yield from self.instances(_path(part) or path, part.get("objectid"), joined, depth + 1)

    def _mesh(self, path: str, number: str, mesh: ElementTree.Element) -> tuple[np.ndarray, np.ndarray]:
        key = (path, number)
        if key not in self._meshes:
            points = [[v.get("x"), v.get("y"), v.get("z")] for v in mesh.iterfind("{*}vertices/{*}vertex")]
            corners = [
                [t.get("v1"), t.get("v2"), t.get("v3")] for t in mesh.iterfind("{*}triangles/{*}triangle")
            ]
            vertices = np.array(points, dtype=np.float64).reshape(-1, 3)
            faces = np.array(corners, dtype=object).reshape(-1, 3).astype(np.int64)
            if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
                raise ValueError(f"object {number} has a triangle beyond its {len(vertices)} vertices")
            self._meshes[key] = vertices, faces
        return self._meshes[key]


def _path(element: ElementTree.Element) -> str | None:
    """Return the ``path`` attribute of the production extension, whatever its namespace."""
    return next((value for key, value in element.attrib.items() if key.split("}")[-1] == "path"), None)


def _matrix(element: ElementTree.Element) -> np.ndarray:
    """Return the transform as (4, 3): a row vector times it is the placed point."""
    text = element.get("transform")
    if not text:
        return np.eye(4)[:, :3]
    return np.array(text.split(), dtype=np.float64).reshape(4, 3)
