"""3MF packages: the objects of a build with their components, each placed by its transforms.

Objects that are no part of the model are left out: supports, and what a slicer takes for a modifier. What a slicer
subtracts is subtracted. The XML is parsed as a stream, so a small package that unpacks to a huge one costs no memory.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, BinaryIO

from vibraverse.contract.texts import counted
from vibraverse.files.formats import Format, MeshData
from vibraverse.files.reading.bounds import MAX_PARTS, Bounds, TooLarge
from vibraverse.files.reading.mistakes import Unsupported
from vibraverse.files.reading.model import Model, Object, Placed
from vibraverse.files.reading.package import Package
from vibraverse.files.reading.slicers import MODIFIER, NEGATIVE, PART, Roles

if TYPE_CHECKING:
    import numpy as np

    from vibraverse.geometry import Mesh

_MAX_DEPTH = 32
#: Types of objects that are part of the model (3MF core, table of the element ``object``).
_MODEL_TYPES = ("model", "surface")


def read(file: BinaryIO, bounds: Bounds) -> MeshData:
    """Return the triangles of all build items of a package, and its unit."""
    import numpy as np

    from vibraverse.files.reading.polygons import Parts

    build = _Build(Package(file), bounds)
    parts = Parts(bounds)
    for item in build.start.items:
        if not item.printed:
            build.left_out["object that is not printed"] += 1
            continue
        for points, triangles, matrix in build.solid(item):
            parts.add(points, triangles, np.array(matrix))
    notes = [f"left out {counted(number, what)}" for what, number in build.left_out.items()]
    if build.subtracted:
        notes.append(f"subtracted {counted(build.subtracted, 'negative volume')}")
    warnings = [
        f"the file requires the 3MF extension {name:.80}, which is not read and may change the shape."
        for name in dict.fromkeys(build.unknown())
    ]
    return MeshData(
        *parts.mesh(), build.start.unit_m, len(parts), tuple(notes), (*warnings, *build.roles.warnings)
    )


def unit_m(file: BinaryIO) -> float | None:
    """Return the metres per unit that a package states, or None if it cannot be read."""
    try:
        package = Package(file)
        return Model(package, package.start(), Bounds(0), only_unit=True).unit_m
    except (ValueError, TooLarge):  # reported when the mesh is read
        return None


class _Build:
    """The model files of a package, parsed once each, and how its build places their objects."""

    def __init__(self, package: Package, bounds: Bounds):
        self.package, self.bounds = package, bounds
        self.left_out: Counter[str] = Counter()
        self.subtracted = 0
        self._models: dict[str, Model] = {}
        self._visits = 0
        self._path = package.start()
        self.start = self._model(self._path)
        self.roles = Roles(package)

    def unknown(self) -> list[str]:
        """Return the extensions that models require and that are not read."""
        return [name for model in self._models.values() for name in model.unknown]

    def solid(self, item: Placed) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Yield vertices, faces and transform (4, 3) of the parts of a build item, without its negative volumes."""
        import numpy as np

        from vibraverse.files.reading.cutting import subtract
        from vibraverse.files.reading.polygons import Parts

        identity = np.eye(4)[:, :3]
        found = list(self._instances(item, item, self._path, identity, PART, 0))
        negative = [part for role, part in found if role == NEGATIVE]
        self.subtracted += len(negative)
        for role, part in found:
            if role == NEGATIVE:
                continue
            if negative:
                cutters = [_moved(Parts(self.bounds), *cutter) for cutter in negative]
                part = (*subtract(_moved(Parts(self.bounds), *part), cutters), identity)
            yield part

    def _model(self, path: str) -> Model:
        """Return the contents of a model file."""
        key = path.lstrip("/").lower()
        if key not in self._models:
            if key not in self.package.names:
                raise ValueError(f"the package lacks its part {path}")
            self._models[key] = Model(self.package, key, self.bounds)
        return self._models[key]

    def _instances(
        self, item: Placed, placed: Placed, default: str, above: np.ndarray, role: str, depth: int
    ) -> Iterator[tuple[str, tuple[np.ndarray, np.ndarray, np.ndarray]]]:
        """Yield the role, and vertices, faces and transform (4, 3), of an object and its components.

        ``item`` is the build item that the object belongs to; ``above`` (4, 3) places what contains the object.
        """
        import numpy as np

        self._visits += 1
        if depth > _MAX_DEPTH:
            raise ValueError("its components refer to each other in a circle")
        if self._visits > MAX_PARTS:
            raise ValueError(f"it places more than {MAX_PARTS} parts")
        path = placed.path or default
        found = self._model(path).objects.get(placed.number)
        if found is None:
            raise ValueError(f"its object {placed.number} does not exist")
        if depth and role == PART:
            role = self.roles.component(item.number, placed.number)
        if role == MODIFIER:
            self.left_out["modifier of a slicer"] += 1
            return
        # Slicers give negative volumes the type "other".
        if role == PART and found.type not in _MODEL_TYPES:
            self.left_out[f"object of type {found.type:.20}"] += 1
            return
        if found.shaped_by:
            raise Unsupported(
                f"its object {placed.number:.20} is {found.shaped_by}, which is not read",
                "Export it as a mesh of triangles.",
            )
        inner = np.array(placed.matrix).reshape(4, 3)
        matrix = np.vstack([inner[:3] @ above[:3], inner[3] @ above[:3] + above[3]])
        yield from self._volumes(placed.number, found, matrix, role)
        for component in found.components:
            yield from self._instances(item, component, path, matrix, role, depth + 1)

    def _volumes(self, number: str, found: Object, matrix: np.ndarray, role: str):
        """Yield the role, and vertices, faces and transform, of the volumes of a mesh."""
        import numpy as np

        points = found.points.array()
        if not len(points):
            return
        triangles = found.triangles.arrays()[0].reshape(-1, 3)
        if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
            raise ValueError(f"object {number} has a triangle beyond its {len(points)} vertices")
        volumes = self.roles.volumes.get(number, found.volumes)
        rest = np.ones(len(triangles), dtype=bool)
        for volume in volumes:
            if volume.role == PART or role != PART:
                continue
            its = slice(max(volume.first, 0), max(volume.last + 1, 0))
            rest[its] = False
            if volume.role == NEGATIVE:
                yield NEGATIVE, (points, triangles[its], matrix)
            else:
                self.left_out["modifier of a slicer"] += 1
        yield role, (points, triangles if rest.all() else triangles[rest], matrix)


def _moved(parts, points: np.ndarray, triangles: np.ndarray, matrix: np.ndarray) -> Mesh:
    """Return a mesh moved by its transform, with the vertices that its triangles use."""
    from vibraverse.geometry.surfaces import compact

    parts.add(points, triangles, matrix)
    return compact(*parts.mesh())


FORMAT = Format("3MF", (".3mf",), read, unit_m)
