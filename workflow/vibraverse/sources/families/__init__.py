"""The table of shape families, and objects drawn from it.

An object's id is the name of its family and a number; the shape depends only on the id. The table names classes by
module, so listing families loads no numerical library.
"""

from __future__ import annotations

import importlib
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from vibraverse.contract.errors import Refused

if TYPE_CHECKING:
    import numpy as np

    from vibraverse.sources.families.shape import Shape


@dataclass(frozen=True)
class Family:
    """A shape family: description, category, and ``module:Class`` of its parameters."""

    description: str
    category: str
    source: str

    @property
    def module(self) -> str:
        """Module of the family."""
        return f"vibraverse.sources.families.{self.source.partition(':')[0]}"

    def load(self) -> type[Shape]:
        """Import and return the dataclass of the family's parameters."""
        return getattr(importlib.import_module(self.module), self.source.partition(":")[2])


#: Category of the open-ended families, whose bodies are of no kind.
OPEN = "abstract"

#: Family name -> family, in the order in which generated objects take turns.
FAMILIES = {
    "bowl": Family("an open bowl on a foot ring", "vessel", "revolved:Bowl"),
    "bell": Family("a bell with a sound bow and a crown", "instrument", "revolved:Bell"),
    "bar": Family("a marimba bar with an undercut", "instrument", "extruded:Bar"),
    "tuning-fork": Family("a tuning fork", "instrument", "extruded:TuningFork"),
    "cup": Family("a cup with a handle", "vessel", "joined:Cup"),
    "vase": Family("a vase with belly, neck and lip", "vessel", "revolved:Vase"),
    "gear": Family("a gear wheel", "hardware", "extruded:Gear"),
    "plate": Family("a dinner plate with a raised rim", "tableware", "revolved:Plate"),
    "blob": Family("a smooth union of balls", "ornament", "joined:Blob"),
    "ring": Family("a bangle with a rounded section", "jewellery", "revolved:Ring"),
    "pipe": Family("a length of pipe", "hardware", "revolved:Pipe"),
    "bottle": Family("a bottle with shoulders, neck and collar", "vessel", "revolved:Bottle"),
    "box": Family("a box with a lid", "container", "joined:Box"),
    "singing-bowl": Family("a thick bowl whose rim turns inwards", "instrument", "revolved:SingingBowl"),
    "gong": Family("a gong with a boss and a rim turned back", "instrument", "revolved:Gong"),
    "goblet": Family("a drinking glass with stem and foot", "vessel", "revolved:Goblet"),
    "chime": Family("a chime plate", "instrument", "extruded:Chime"),
    "wrench": Family("a wrench", "tool", "extruded:Wrench"),
    "spoon": Family("a spoon", "tableware", "joined:Spoon"),
    "triangle": Family("a triangle to strike", "instrument", "joined:Triangle"),
    "cymbal": Family("a cymbal with cup, bow and hole", "instrument", "revolved:Cymbal"),
    "teapot": Family("a teapot", "vessel", "joined:Teapot"),
    "pan": Family("a frying pan", "vessel", "joined:Pan"),
    "hammer": Family("a hammer", "tool", "joined:Hammer"),
    "horseshoe": Family("a horseshoe", "hardware", "extruded:Horseshoe"),
    "star": Family("a star to hang up", "ornament", "extruded:Star"),
    "key": Family("an old key", "hardware", "extruded:Key"),
    "pawn": Family("a chess pawn", "toy", "revolved:Pawn"),
    "stool": Family("a stool", "furniture", "joined:Stool"),
    "knot": Family("a trefoil knot", "ornament", "joined:Knot"),
    "tree": Family("unions, cuts and intersections of random solids", OPEN, "composed:Tree"),
    "blend": Family("a smooth blend of random bodies", OPEN, "blended:Blend"),
    "lathe": Family("a turned body with a random profile", OPEN, "turned:Lathe"),
    "sweep": Family("a changing section swept along a random line", OPEN, "swept:Sweep"),
    "shell": Family("a random wall: turned, a wavy or bent plate, or an opened blend", OPEN, "shells:Shell"),
    "bent": Family("a random bar, tapered, twisted and bent", OPEN, "bent:Bent"),
    "perforated": Family("a plate, block, tube or ball with random holes", OPEN, "perforated:Perforated"),
}

#: Words that stand for families in a configuration. ``parametric`` is what the default run draws from.
GROUPS = {
    "parametric": [name for name, family in FAMILIES.items() if family.category != OPEN],
    "open-ended": [name for name, family in FAMILIES.items() if family.category == OPEN],
    "all": list(FAMILIES),
}


def named(words: list[str]) -> list[str]:
    """Return families by their names and by the words of :data:`GROUPS`, each once, in the order of the words."""
    return list(dict.fromkeys(name for word in words for name in GROUPS.get(word, [word])))


@dataclass(frozen=True)
class Generated:
    """A generated object: a closed surface in metres, centred at the origin, with its family and parameters."""

    vertices: np.ndarray
    faces: np.ndarray
    size_m: float
    parameters: dict
    family: str
    title: str
    category: str


def drawn(object_: str) -> Shape:
    """Return the parameters of a generated object without building it; raises as :func:`generate`."""
    from vibraverse.sources.families.shape import draw

    shape, _, cavity = object_.partition("_")
    name, _, number = shape.rpartition("-")
    if name not in FAMILIES or not number.isdigit() or not (cavity or "1").isdigit():
        raise Refused(
            "unavailable",
            f"No shape family makes the object {object_}.",
            "Ids are a family's name and a number; `vibraverse objects --families` lists the families.",
        )
    return draw(FAMILIES[name].load(), shape)


def generate(object_: str) -> Generated:
    """Return the object with an id such as ``bowl-0007``: the same arrays, bit for bit, every time.

    ``bowl-0007_2`` is another object of that shape, whose hollow body has a cavity of its own.

    ``vertices`` (V, 3) float64 in metres and ``faces`` (F, 3) int64 are one closed, connected manifold surface,
    counter-clockwise seen from outside. Raises :class:`Refused` (``unavailable``) for an id of no family.
    """
    from vibraverse.sources.families.shape import in_metres

    shape = drawn(object_)
    name = object_.rpartition("-")[0]
    family = FAMILIES[name]
    vertices, faces = shape.build()
    return Generated(
        vertices=in_metres(vertices, shape.size_m),
        faces=faces,
        size_m=shape.size_m,
        parameters=asdict(shape),
        family=name,
        title=family.description[0].upper() + family.description[1:],
        category=family.category,
    )
