"""3MF packages to arrays: meshes, components and build items with their transforms.

Implements the geometry of the 3MF core specification 1.3 and the ``path`` attribute of its production
extension, which slicers use to keep each object in a file of its own. The XML is read as a stream, so a small package
that unpacks into a huge one costs no memory.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, field
from typing import BinaryIO
from xml.parsers import expat

import numpy as np

from vibraverse.files.formats.bounds import MAX_BYTES, MAX_PARTS, Bounds, TooLarge
from vibraverse.files.formats.polygons import Parts, Points, Polygons

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
_CHUNK = 1 << 20
_MAX_SILENT = 1 << 24


@dataclass(frozen=True)
class _Placed:
    """A component or a build item: which object of which model file, and where (4, 3)."""

    path: str | None
    number: str | None
    matrix: np.ndarray


@dataclass
class _Object:
    points: Points
    triangles: Polygons
    components: list[_Placed] = field(default_factory=list)


def parse_3mf(file: BinaryIO, bounds: Bounds) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Return vertices (V, 3), faces (F, 3), metres per unit and the number of parts of a 3MF package.

    Only what the build section places exists. Raises :class:`vibraverse.files.formats.bounds.TooLarge` and
    ``ValueError`` (or what the ZIP and XML readers raise) for a package that is not a valid 3MF file.
    """
    package = _Package(file, bounds)
    start, parts = package.model(package.start), Parts(bounds)
    for item in start.items:
        for placed in package.instances(item, package.start, np.eye(4)[:, :3], 0):
            parts.add(*placed)
    return *parts.mesh(), start.unit_m, len(parts)


def unit_m(file: BinaryIO) -> float | None:
    """Return the metres per unit that a 3MF package states, or None when it cannot be read."""
    try:
        package = _Package(file, Bounds(0))
        return package.model(package.start, only_unit=True).unit_m
    except Exception:  # whatever is wrong with the package is said when its mesh is read
        return None


class _Package:
    """The model files of a package, parsed once each."""

    def __init__(self, file: BinaryIO, bounds: Bounds):
        self.archive, self.bounds = zipfile.ZipFile(file), bounds
        self.names = {name.lstrip("/").lower(): name for name in self.archive.namelist()}
        models = [name for name in self.names if name.endswith("3dmodel.model")]
        models = models or [name for name in self.names if name.endswith(".model")]
        if not models:
            raise ValueError("the package holds no 3D model")
        self.start = models[0]
        self._models: dict[str, _Model] = {}
        self._left = MAX_BYTES
        self._visits = 0

    def model(self, path: str, only_unit: bool = False) -> _Model:
        """Return what a model file holds."""
        key = path.lstrip("/").lower()
        if key not in self._models:
            if key not in self.names:
                raise ValueError(f"the package lacks its part {path}")
            info = self.archive.getinfo(self.names[key])
            self._left -= info.file_size
            if self._left < 0 and not only_unit:
                raise TooLarge(f"unpacks into more than {MAX_BYTES >> 20} MB")
            with self.archive.open(info) as stream:
                self._models[key] = _Model(stream, self.bounds, only_unit)
        return self._models[key]

    def instances(self, placed: _Placed, default: str, above: np.ndarray, depth: int):
        """Yield vertices, faces and placing matrix (4, 3) of an object and of its components; ``above`` places it."""
        self._visits += 1
        if depth > _MAX_DEPTH:
            raise ValueError("its components refer to each other in a circle")
        if self._visits > MAX_PARTS:
            raise ValueError(f"it places more than {MAX_PARTS} parts")
        path = placed.path or default
        found = self.model(path).objects.get(placed.number or "")
        if found is None:
            raise ValueError(f"there is no object {placed.number}")
        inner = placed.matrix
        matrix = np.vstack([inner[:3] @ above[:3], inner[3] @ above[:3] + above[3]])
        points = found.points.array()
        if len(points):
            triangles = found.triangles.arrays()[0].reshape(-1, 3)
            if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
                raise ValueError(f"object {placed.number} has a triangle beyond its {len(points)} vertices")
            yield points, triangles, matrix
        for component in found.components:
            yield from self.instances(component, path, matrix, depth + 1)


class _UnitRead(Exception):
    """Ends the reading of a model of which only the unit is wanted."""


class _Model:
    """One model file, read as a stream: its unit, its objects by id, and what its build section places."""

    def __init__(self, stream: BinaryIO, bounds: Bounds, only_unit: bool):
        self.unit_m = UNITS_M["millimeter"]
        self.objects: dict[str, _Object] = {}
        self.items: list[_Placed] = []
        self._bounds, self._only_unit = bounds, only_unit
        self._object: _Object | None = None
        self._elements = self._placed = 0
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.StartDoctypeDeclHandler = self._doctype
        silent = 0
        try:
            while chunk := stream.read(_CHUNK):
                before = self._elements
                parser.Parse(chunk)
                silent = 0 if self._elements > before else silent + len(chunk)
                if silent > _MAX_SILENT:
                    raise ValueError(f"its model has {silent >> 20} MB without an element")
            parser.Parse(b"", True)
        except _UnitRead:
            return

    def _doctype(self, *_):
        raise ValueError("its model has a document type declaration, which 3MF forbids")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        name = name.rpartition(":")[2]
        self._elements += 1
        if self._elements > 2 * (self._bounds.max_vertices + self._bounds.max_triangles) + 100_000:
            raise TooLarge(f"has more than {self._elements - 1} elements in its model")
        if self._object is not None and name == "vertex":
            self._object.points.add(*(float(attributes[axis]) for axis in "xyz"))
        elif self._object is not None and name == "triangle":
            self._object.triangles.add([int(attributes[corner]) for corner in ("v1", "v2", "v3")])
        elif name == "object":
            self._object = _Object(Points(self._bounds), Polygons(self._bounds))
            self.objects[attributes.get("id", "")] = self._object
        elif name in ("component", "item"):
            self._placed += 1
            if self._placed > MAX_PARTS:
                raise ValueError(f"it places more than {MAX_PARTS} parts")
            path = next(
                (value for key, value in attributes.items() if key.rpartition(":")[2] == "path"), None
            )
            placed = _Placed(path, attributes.get("objectid"), _matrix(attributes.get("transform")))
            if name == "item":
                self.items.append(placed)
            elif self._object is not None:
                self._object.components.append(placed)
        elif name == "model":
            unit = attributes.get("unit", "millimeter")
            if unit not in UNITS_M:
                raise ValueError(f"unknown unit {unit!r:.40}")
            self.unit_m = UNITS_M[unit]
            if self._only_unit:
                raise _UnitRead


def _matrix(text: str | None) -> np.ndarray:
    """Return a transform as (4, 3): a row vector times it is the placed point."""
    if not text:
        return np.eye(4)[:, :3]
    return np.array(text.split(), dtype=np.float64).reshape(4, 3)
