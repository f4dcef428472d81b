"""Options of the stages that make geometry."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveFloat, PositiveInt, field_validator

from vibraverse.config.base import Section


class Limits(Section):
    """Limits of a tool that runs in a child process."""

    seconds: PositiveInt = 300
    """CPU time after which the tool is stopped and the object refused; also how long it may stand still."""

    memory_mb: PositiveInt = 4096
    """Memory, besides its libraries', beyond which the tool is stopped and the object refused."""


class Clean(Section):
    """Mesh cleaning."""

    max_triangles: PositiveInt = 2_000_000
    """A larger mesh is refused."""

    max_dropped: float = Field(0.5, ge=0, lt=1)
    """Of bodies that lie apart the largest is kept; when the others hold more of the volume, the object is refused."""

    open_sheets: Literal["refuse", "thicken"] = "refuse"
    """What to do with a surface that encloses nothing, such as a cloth or a terrain."""

    sheet_thickness: float = Field(0.02, ge=0.005, le=0.2)
    """Thickness of a thickened sheet, as a share of its longest side."""

    limits: Limits = Limits()
    """Limits of reading and repairing the mesh."""


class Grids(Section):
    """Voxel and signed-distance grids over [-1, 1]³, sampled at cell centres."""

    coarse: int = Field(16, ge=4, le=128)
    """Cells along each axis of the occupancy grid."""

    fine: int = Field(128, ge=16, le=512)
    """Cells along each axis of the signed-distance grid."""


class Hollow(Section):
    """Hollow bodies: the outside stays, ``S(P) <= t · s_min`` is taken away."""

    thickness: tuple[float, float] = (0.3, 0.7)
    """Range of ``t``, drawn by the object's seed: the wall reaches ``t`` of the way to the deepest point."""

    min_kept: float = Field(0.0, ge=0, lt=1)
    """Refuse a hollow body whose cavity has less than this share of the volume that ``t`` asks for."""

    limits: Limits = Limits()
    """Limits of making the cavity."""

    @field_validator("thickness")
    @classmethod
    def _inside_the_body(cls, thickness):
        low, high = thickness
        if not 0 < low <= high < 1:
            raise ValueError("the two numbers must satisfy 0 < low <= high < 1")
        return thickness


class Tets(Section):
    """Tetrahedra."""

    target_elements: PositiveInt = 5000
    """Number of tetrahedra to aim for; thin-walled bodies may take twice as many."""

    max_volume_change: PositiveFloat = 0.005
    """Largest relative change of volume that remeshing the surface may cause."""

    min_dihedral_deg: float = Field(0.1, ge=0, lt=60)
    """Smallest angle between two faces of a tetrahedron, in degrees, that a mesh may have."""

    limits: Limits = Limits()
    """Limits of the mesher."""
