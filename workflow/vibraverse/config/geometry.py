"""Options of the stages that make geometry."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveFloat, PositiveInt, field_validator

from vibraverse.config.base import Section


class Limits(Section):
    """Limits of a tool that runs in a child process."""

    seconds: PositiveInt = 300
    """CPU time in seconds after which the tool is stopped and the object refused; also the limit on time without
    progress."""

    memory_mb: PositiveInt = 4096
    """Memory in MB, not counting libraries, above which the tool is stopped and the object refused."""


class Clean(Section):
    """Mesh cleaning."""

    max_triangles: PositiveInt = 2_000_000
    """Largest number of triangles of a mesh; larger meshes are refused."""

    max_dropped: float = Field(0.5, ge=0, lt=1)
    """Largest share of the volume that may be dropped. The largest of separate bodies is kept; the object is refused if
    the others hold more."""

    max_joined: float = Field(0.25, ge=0)
    """Largest relative change of the volume by a wrap that joins bodies which lie apart; a wrap beyond it is not taken,
    and the largest body alone is kept or the object refused."""

    open_sheets: Literal["refuse", "thicken"] = "refuse"
    """Treatment of a surface that encloses no volume, such as a cloth or a terrain."""

    sheet_thickness: float = Field(0.02, ge=0.005, le=0.2)
    """Thickness of a thickened sheet, as a share of its longest side."""

    limits: Limits = Limits()
    """Limits on reading and repairing the mesh."""


class Grids(Section):
    """Voxel and signed-distance grids over [-1, 1]³, sampled at cell centres."""

    coarse: int = Field(16, ge=4, le=128)
    """Cells along each axis of the occupancy grid."""

    fine: int = Field(128, ge=16, le=512)
    """Cells along each axis of the signed-distance grid."""


class Hollow(Section):
    """Hollow bodies: the cavity is ``S(P) <= t · s_min``, and the outside does not change."""

    thickness: tuple[float, float] = (0.3, 0.7)
    """Range of ``t``, drawn by the object's seed: the wall is ``t`` times the depth of the deepest point."""

    min_kept: float = Field(0.0, ge=0, lt=1)
    """Smallest share of the wanted volume that a cavity must have; otherwise the hollow body is refused."""

    limits: Limits = Limits()
    """Limits on making the cavity."""

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
    """Target number of tetrahedra; thin-walled bodies may get twice as many."""

    max_elements: PositiveInt = 24_000
    """Most tetrahedra of a body, or three times ``target_elements`` if that is more. Where sheets are so close that a
    recipe takes more, a rougher one is tried."""

    max_volume_change: PositiveFloat = 0.005
    """Largest relative change of volume by remeshing."""

    max_wrap_change: float = Field(0.05, ge=0, lt=1)
    """Largest relative change of volume by a wrap, the last recipe, for surfaces that nothing else fills; 0 rules
    it out."""

    min_dihedral_deg: float = Field(0.1, ge=0, lt=60)
    """Smallest dihedral angle of a tetrahedron that a mesh may have, in degrees."""

    limits: Limits = Limits()
    """Limits on the mesher."""
