"""3MF packages: meshes, components and build items with their transforms.

Implemented are the geometry of the 3MF core specification 1.3 and the ``path`` attribute of its production extension.
By that attribute slicers keep each object in a separate file. The XML is parsed as a stream, so a small package that
unpacks to a huge one costs no memory.
"""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO
from xml.parsers import expat

from vibraverse.contract.refusal import said
from vibraverse.files.formats import Format, MeshData
from vibraverse.files.reading.bounds import MAX_BYTES, MAX_PARTS, Bounds, TooLarge

if TYPE_CHECKING:
    import numpy as np

    from vibraverse.files.reading.polygons import Points, Polygons

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
_CHUNK_BYTES = 1 << 20
_MAX_SILENT_BYTES = 1 << 24
#: The identity transform: three rows of a matrix, then the translation.
_IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
#: Exceptions of the standard library for packages that are damaged, encrypted or compressed by an unknown method.
_DAMAGED = (
    EOFError,
    LookupError,
    NotImplementedError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
    lzma.LZMAError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True)
class _Placed:
    """A component or a build item: the object, its model file and its transform."""

    path: str | None
    number: str
    matrix: tuple[float, ...]


@dataclass
class _Object:
    points: Points
    triangles: Polygons
    components: list[_Placed] = field(default_factory=list)


def read(file: BinaryIO, bounds: Bounds) -> MeshData:
    """Return the triangles of all build items of a package, and its unit."""
    import numpy as np

    from vibraverse.files.reading.polygons import Parts

    package = _Package(file, bounds)
    start, parts = package.model(package.start), Parts(bounds)
    for item in start.items:
        for placed in package.instances(item, package.start, np.eye(4)[:, :3], 0):
            parts.add(*placed)
    return MeshData(*parts.mesh(), start.unit_m, len(parts))


def unit_m(file: BinaryIO) -> float | None:
    """Return the metres per unit that a package states, or None if it cannot be read."""
    try:
        package = _Package(file, Bounds(0))
        return package.model(package.start, only_unit=True).unit_m
    except (ValueError, TooLarge):  # reported when the mesh is read
        return None


@contextmanager
def _opened() -> Iterator[None]:
    """Raise ``ValueError`` for exceptions of the standard library; only calls into it belong inside."""
    try:
        yield
    except _DAMAGED as error:
        raise ValueError(f"its package is damaged ({said(error)})") from None


class _Package:
    """The model files of a package, parsed once each."""

    def __init__(self, file: BinaryIO, bounds: Bounds):
        with _opened():
            self.archive = zipfile.ZipFile(file)
        self.bounds = bounds
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
        """Return the contents of a model file."""
        key = path.lstrip("/").lower()
        if key not in self._models:
            if key not in self.names:
                raise ValueError(f"the package lacks its part {path}")
            info = self.archive.getinfo(self.names[key])
            self._left -= info.file_size
            if self._left < 0 and not only_unit:
                raise TooLarge(f"unpacks into more than {MAX_BYTES >> 20} MB")
            self._models[key] = _Model(self._unpacked(info), self.bounds, only_unit)
        return self._models[key]

    def _unpacked(self, info: zipfile.ZipInfo) -> Iterator[bytes]:
        """Yield the bytes of a part in chunks."""
        with _opened():
            stream = self.archive.open(info)
        with stream:
            while True:
                with _opened():
                    piece = stream.read(_CHUNK_BYTES)
                if not piece:
                    return
                yield piece

    def instances(
        self, placed: _Placed, default: str, above: np.ndarray, depth: int
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Yield vertices, faces and transform (4, 3) of an object and its components, placed by ``above`` (4, 3)."""
        import numpy as np

        self._visits += 1
        if depth > _MAX_DEPTH:
            raise ValueError("its components refer to each other in a circle")
        if self._visits > MAX_PARTS:
            raise ValueError(f"it places more than {MAX_PARTS} parts")
        path = placed.path or default
        found = self.model(path).objects.get(placed.number)
        if found is None:
            raise ValueError(f"its object {placed.number} does not exist")
        inner = np.array(placed.matrix).reshape(4, 3)
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
    """Stops the parser of a model when only its unit is wanted."""


class _Model:
    """A model file, parsed as a stream: its unit, its objects by id, and its build items."""

    def __init__(self, pieces: Iterator[bytes], bounds: Bounds, only_unit: bool):
        self.unit_m = UNITS_M["millimeter"]
        self.objects: dict[str, _Object] = {}
        self.items: list[_Placed] = []
        self._bounds, self._only_unit = bounds, only_unit
        self._object: _Object | None = None
        self._elements = self._placed = 0
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.StartDoctypeDeclHandler = self._doctype
        parser.XmlDeclHandler = self._declaration
        silent = 0
        try:
            for piece in pieces:
                before = self._elements
                parser.Parse(piece)
                silent = 0 if self._elements > before else silent + len(piece)
                if silent > _MAX_SILENT_BYTES:
                    raise ValueError(f"its model has {silent >> 20} MB without an element")
            parser.Parse(b"", True)
        except _UnitRead:
            return
        except expat.ExpatError as error:
            raise ValueError(f"its model is no valid XML ({error})") from None

    def _declaration(self, version: str, encoding: str | None, standalone: int) -> None:
        try:
            b" ".decode(encoding or "utf-8")
        except (LookupError, ValueError):
            raise ValueError(f"its model has the unknown encoding {encoding!r:.40}") from None

    def _doctype(self, *_):
        raise ValueError("its model has a document type declaration, which 3MF forbids")

    def _new_object(self) -> _Object:
        from vibraverse.files.reading.polygons import Points, Polygons

        return _Object(Points(self._bounds), Polygons(self._bounds))

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        name = name.rpartition(":")[2]
        self._elements += 1
        if self._elements > 2 * (self._bounds.max_vertices + self._bounds.max_triangles) + 100_000:
            raise TooLarge(f"has more than {self._elements - 1} elements in its model")
        if self._object is not None and name == "vertex":
            self._object.points.add(*_numbers(float, name, attributes, ("x", "y", "z")))
        elif self._object is not None and name == "triangle":
            self._object.triangles.add(_numbers(int, name, attributes, ("v1", "v2", "v3")))
        elif name == "object":
            self._object = self._new_object()
            self.objects[attributes.get("id", "")] = self._object
        elif name in ("component", "item"):
            self._placed += 1
            if self._placed > MAX_PARTS:
                raise ValueError(f"it places more than {MAX_PARTS} parts")
            path = next(
                (value for key, value in attributes.items() if key.rpartition(":")[2] == "path"), None
            )
            placed = _Placed(path, attributes.get("objectid", ""), _matrix(attributes.get("transform")))
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


def _numbers(kind: type, element: str, attributes: dict[str, str], names: tuple[str, ...]) -> list:
    """Return attributes of an element as numbers of type ``kind``, int or float."""
    try:
        return [kind(attributes[name]) for name in names]
    except (KeyError, ValueError):
        held = " ".join(f"{name}={attributes.get(name)!r:.20}" for name in names)
        raise ValueError(f"its model has a {element} with {held}") from None


def _matrix(text: str | None) -> tuple[float, ...]:
    """Return the twelve numbers of a transform for row vectors: three rows, then the translation."""
    if not text:
        return _IDENTITY
    words = text.split()
    if len(words) != len(_IDENTITY):
        raise ValueError(f"its model has a transform of {len(words)} numbers instead of {len(_IDENTITY)}")
    try:
        return tuple(map(float, words))
    except ValueError:
        raise ValueError(f"its model has the transform {text[:60]!r}") from None


FORMAT = Format("3MF", (".3mf",), read, unit_m)
