"""Options of the stages that make sounds and pictures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeInt, PositiveFloat, field_validator

from vibraverse.config.base import Section
from vibraverse.physics.materials import sampled_name

#: What of a motion can be heard.
Observable = Literal["displacement", "velocity", "acceleration"]
_Normalised = Annotated[float, Field(ge=-1, le=1)]


class Audio(Section):
    """Impact sounds."""

    sample_rate_hz: int = Field(44_100, ge=8_000, le=192_000)
    """Samples per second."""

    subtype: Literal["PCM_24", "PCM_16"] = "PCM_24"
    """Sample format of the WAV files."""

    decay_db: PositiveFloat = 60.0
    """A sound ends when it has fallen by this many decibels …"""

    max_s: float = Field(4.0, gt=0, le=60)
    """… or this many seconds after the contact."""

    contact_s: float = Field(0.0, ge=0, le=0.1)
    """Seconds that the striker touches the body, pressing by half a sine; 0 is an impulse. A hard striker touches for
    less than 0.1 ms, a soft one for some milliseconds."""

    observable: Observable = "displacement"
    """What of the motion is heard: ``displacement``, ``velocity`` or ``acceleration``. Each is brighter than the one
    before."""

    points: list[tuple[_Normalised, _Normalised, _Normalised]] = Field(default_factory=list)
    """Struck points in normalised coordinates, -1 to 1; each adds a sound per material. Empty: only the
    location-invariant sound."""

    sampled: NonNegativeInt = 0
    """Number of sampled materials, the first ones, that also get a location-invariant sound."""

    def names(self, materials) -> list[str]:
        """Return the names of the sounds of a body, without extensions: ``ceramic``, ``ceramic-p0``, …"""
        struck = ["", *(f"-p{index}" for index in range(len(self.points)))]
        named = [f"{material}{suffix}" for material in materials for suffix in struck]
        return named + [sampled_name(number) for number in range(self.sampled)]


def split_sound(name: str, materials) -> tuple[str | None, int | None]:
    """Return the material and the number of the struck point in the name of a sound, each None if it has none."""
    if name in materials:
        return name, None
    material, _, point = name.rpartition("-p")
    return (material, int(point)) if material in materials and point.isdigit() else (None, None)


class Images(Section):
    """Pictures of the outside."""

    views: int = Field(6, ge=1, le=64)
    """Views per look, spread evenly around the object."""

    looks: list[str] = Field(default_factory=lambda: ["clay", "ceramic", "glass", "wood", "steel"])
    """Looks to render: ``clay`` is neutral, the others are named like materials. Duplicates are ignored."""

    size_px: int = Field(256, ge=32, le=4096)
    """Width and height in pixels."""

    @field_validator("looks")
    @classmethod
    def _each_once(cls, looks: list[str]) -> list[str]:
        return list(dict.fromkeys(looks))

    def names(self) -> list[str]:
        """Return the names of the pictures of an object, without extensions: ``clay-00``, ``clay-01``, …"""
        return [f"{look}-{view:02d}" for look in self.looks for view in range(self.views)]
