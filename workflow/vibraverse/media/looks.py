"""Looks of the materials: colours and gloss for physically based shading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Look:
    """The appearance of a material.

    ``colour`` is sRGB in 0…1; for ``clear`` materials it is the transmission of white light over one body length.
    ``metallic`` and ``roughness`` are in 0…1. ``kind`` selects the shader: ``plain``, ``wood`` (growth rings through
    the body, where ``second`` is the colour of late wood) or ``clear`` (refracts the surroundings).
    """

    colour: tuple[float, float, float]
    metallic: float = 0.0
    roughness: float = 0.5
    kind: Literal["plain", "wood", "clear"] = "plain"
    second: tuple[float, float, float] = (0.0, 0.0, 0.0)


#: Looks by the name of the material; ``clay`` is neutral.
LOOKS = {
    "clay": Look((0.80, 0.75, 0.69), roughness=0.75),
    "ceramic": Look((0.88, 0.86, 0.81), roughness=0.15),
    "glass": Look((0.87, 0.96, 0.93), roughness=0.02, kind="clear"),
    "wood": Look((0.76, 0.54, 0.33), roughness=0.45, kind="wood", second=(0.49, 0.30, 0.16)),
    "plastic": Look((0.80, 0.16, 0.13), roughness=0.35),
    "iron": Look((0.47, 0.46, 0.45), metallic=1.0, roughness=0.55),
    "polycarbonate": Look((0.85, 0.92, 0.985), roughness=0.20, kind="clear"),
    "steel": Look((0.77, 0.78, 0.80), metallic=1.0, roughness=0.22),
    "tin": Look((0.87, 0.86, 0.83), metallic=1.0, roughness=0.40),
}


def look_of(name: str) -> Look:
    """Return the look of a material; clay if it is not in the table."""
    return LOOKS.get(name, LOOKS["clay"])
