"""A model file of a 3MF package, parsed as a stream: its unit, its objects and its build items.

Implemented are the geometry of the 3MF core specification 1.3, the ``path`` attribute of its production extension, and
the volumes that Slic3r writes into the model.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from vibraverse.files.reading.bounds import MAX_PARTS, Bounds, TooLarge
from vibraverse.files.reading.package import Package, Stop
from vibraverse.files.reading.slicers import MODIFIER, PART, Volume, volume

if TYPE_CHECKING:
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
#: The identity transform: three rows of a matrix, then the translation.
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

#: Element that makes geometry in place of triangles, or from them -> what it is.
SHAPING = {
    "beamlattice": "a beam lattice",
    "booleanshape": "a Boolean operation",
    "displacementmesh": "a displaced surface",
    "levelset": "a level set",
}
#: What an object holds whose mesh is only a coarse stand-in (slice extension).
_SLICES = "a stack of slices"
#: Words in the namespaces of extensions that change no geometry, are read, or are told by their elements.
_KNOWN_NAMESPACES = (
    "beamlattice", "booleanoperations", "displacement", "implicit", "material", "production", "slice", "trianglesets",
    "volumetric",
)  # fmt: skip


@dataclass(frozen=True)
class Placed:
    """A component or a build item: the object, its model file and its transform."""

    path: str | None
    number: str
    matrix: tuple[float, ...]
    printed: bool = True


@dataclass
class Object:
    """An object of a model: a mesh, or components of other objects."""

    type: str
    points: Points
    triangles: Polygons
    components: list[Placed] = field(default_factory=list)
    volumes: list[Volume] = field(default_factory=list)
    shaped_by: str = ""
    """What makes its geometry in place of triangles, or an empty string."""


class Model:
    """A model file of a package; ``unknown`` names the extensions that it requires and that are not read."""

    def __init__(self, package: Package, name: str, bounds: Bounds, only_unit: bool = False):
        self.unit_m = UNITS_M["millimeter"]
        self.objects: dict[str, Object] = {}
        self.items: list[Placed] = []
        self.unknown: list[str] = []
        self._bounds, self._only_unit = bounds, only_unit
        self._object: Object | None = None
        self._elements = self._placed = 0
        package.parse(name, self._start, self._end, unbounded=only_unit)

    def _new_object(self, type_: str) -> Object:
        from vibraverse.files.reading.polygons import Points, Polygons

        return Object(type_, Points(self._bounds), Polygons(self._bounds))

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._elements += 1
        if self._elements > 2 * (self._bounds.max_vertices + self._bounds.max_triangles) + 100_000:
            raise TooLarge(f"has more than {self._elements - 1} elements in its model")
        if self._object is not None and name == "vertex":
            self._object.points.add(*_numbers(float, name, attributes, ("x", "y", "z")))
        elif self._object is not None and name == "triangle":
            self._object.triangles.add(_numbers(int, name, attributes, ("v1", "v2", "v3")))
        elif name == "object":
            self._object = self._new_object(attributes.get("type", "model"))
            self.objects[attributes.get("id", "")] = self._object
            if attributes.get("meshresolution") == "lowres":
                self._object.shaped_by = _SLICES
        elif name in ("component", "item"):
            self._place(name, attributes)
        elif name in SHAPING and self._object is not None:
            self._object.shaped_by = SHAPING[name]
        elif name == "volume" and self._object is not None:
            role = MODIFIER if attributes.get("modifier") == "1" else PART
            self._object.volumes.append(volume(attributes.get("ts", ""), attributes.get("te", ""), role))
        elif name == "model":
            unit = attributes.get("unit", "millimeter")
            if unit not in UNITS_M:
                raise ValueError(f"unknown unit {unit!r:.40}")
            self.unit_m = UNITS_M[unit]
            if self._only_unit:
                raise Stop
            for prefix in attributes.get("requiredextensions", "").split():
                namespace = attributes.get(f"xmlns:{prefix}", prefix)
                if not any(word in namespace.lower() for word in _KNOWN_NAMESPACES):
                    self.unknown.append(namespace)

    def _end(self, name: str) -> None:
        if name == "object":
            self._object = None

    def _place(self, name: str, attributes: dict[str, str]) -> None:
        """Append a component to the object, or an item to the build."""
        self._placed += 1
        if self._placed > MAX_PARTS:
            raise ValueError(f"it places more than {MAX_PARTS} parts")
        local = {key.rpartition(":")[2]: value for key, value in attributes.items()}
        placed = Placed(
            local.get("path"),
            attributes.get("objectid", ""),
            _matrix(attributes.get("transform")),
            local.get("printable") != "0",
        )
        if name == "item":
            self.items.append(placed)
        elif self._object is not None:
            self._object.components.append(placed)


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
        return IDENTITY
    words = text.split()
    if len(words) != len(IDENTITY):
        raise ValueError(f"its model has a transform of {len(words)} numbers instead of {len(IDENTITY)}")
    try:
        return tuple(map(float, words))
    except ValueError:
        raise ValueError(f"its model has the transform {text[:60]!r}") from None
