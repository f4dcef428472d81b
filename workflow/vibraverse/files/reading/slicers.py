"""Roles that slicers give to the parts of an object in a 3MF package: parts of the model, negative volumes, modifiers.

A slicer keeps all its volumes as meshes of the model and says in a file of its own which of them are no material.
PrusaSlicer and SuperSlicer name ranges of triangles (``Metadata/Slic3r_PE_model.config``), Bambu Studio and OrcaSlicer
components (``Metadata/model_settings.config``), and Slic3r ranges of triangles inside the model.
"""

from __future__ import annotations

from dataclasses import dataclass

from vibraverse.files.reading.package import Package

PART, NEGATIVE, MODIFIER = "part", "negative volume", "modifier"
#: What slicers call a volume, without case and underscores -> its role; support blockers and enforcers are modifiers.
_ROLES = {"modelpart": PART, "normalpart": PART, "negativevolume": NEGATIVE, "negativepart": NEGATIVE}


@dataclass(frozen=True)
class Volume:
    """The role of the triangles from ``first`` to ``last`` of an object."""

    first: int
    last: int
    role: str


class Roles:
    """The roles in a package, by the numbers of objects and of their components; what is not named is a part."""

    def __init__(self, package: Package):
        self.volumes: dict[str, list[Volume]] = {}
        self.warnings: list[str] = []
        self._components: dict[tuple[str, str], str] = {}
        for name in package.names:
            if name.startswith("metadata/") and name.endswith(("_model.config", "model_settings.config")):
                try:
                    _Config(package, name, self)
                except ValueError:
                    self.warnings.append(
                        f"the slicer's settings {name:.80} cannot be read, so its negative volumes and modifiers, if "
                        "any, count as parts of the body."
                    )

    def component(self, object_: str, component: str) -> str:
        """Return the role of a component of an object of the build."""
        return self._components.get((object_, component), PART)

    def add(self, object_: str, component: str, span: tuple[str, str] | None, role: str) -> None:
        """Set the role of a range of triangles of an object, or of one of its components."""
        if span is None:
            self._components[object_, component] = role
        else:
            self.volumes.setdefault(object_, []).append(volume(*span, role))


class _Config:
    """A slicer's file, parsed as a stream into ``roles``."""

    def __init__(self, package: Package, name: str, roles: Roles):
        self.roles, self.object = roles, ""
        self.component, self.span, self.role = "", None, None
        package.parse(name, self._start, self._end)

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        if name == "object":
            self.object = attributes.get("id", "")
        elif name in ("volume", "part"):
            self.component, self.role = attributes.get("id", ""), role_of(attributes.get("subtype", ""))
            named = "firstid" in attributes and "lastid" in attributes
            self.span = (attributes["firstid"], attributes["lastid"]) if named else None
        elif name == "metadata" and self.role is not None:
            key, value = attributes.get("key"), attributes.get("value", "")
            if key == "volume_type":
                self.role = role_of(value)
            elif key == "modifier" and value == "1" and self.role == PART:
                self.role = MODIFIER

    def _end(self, name: str) -> None:
        if name in ("volume", "part") and self.role is not None:
            self.roles.add(self.object, self.component, self.span, self.role)
            self.role = None


def role_of(kind: str) -> str:
    """Return the role of a volume by what a slicer calls it; "" is a part."""
    return _ROLES.get(kind.replace("_", "").lower(), MODIFIER) if kind else PART


def volume(first: str, last: str, role: str) -> Volume:
    """Return the role of a range of triangles whose ends are texts."""
    try:
        return Volume(int(first), int(last), role)
    except ValueError:
        raise ValueError(f"a slicer's volume has the triangles {first!r:.20} to {last!r:.20}") from None
