"""Options of materials and of the stages that compute modes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt, field_validator, model_validator

from vibraverse.config.base import Section, Size, plausible
from vibraverse.physics.plausible import DENSITY_KG_M3, YOUNG_PA, density_mistake, pair_mistake, young_mistake

#: Poisson's ratio of a stable isotropic solid that is not incompressible.
Poisson = Annotated[float, Field(gt=-1.0, lt=0.5)]
Density = plausible(density_mistake, DENSITY_KG_M3)
Young = plausible(young_mistake, YOUNG_PA)


def ascending(value: tuple[float, float]) -> tuple[float, float]:
    """Return a range unchanged; raises :class:`ValueError` if its ends descend."""
    if value[0] > value[1]:
        raise ValueError(f"must ascend, not fall from {value[0]:g} to {value[1]:g}")
    return value


class Material(Section):
    """A material: elasticity, density and Rayleigh damping."""

    density_kg_m3: Density
    """Density in kg/m³, 1 to 25,000."""

    young_pa: Young
    """Young's modulus in Pa, 1e3 to 1.5e12. The speed of sound that follows from it and the density must be at most
    35 km/s, and at least 12 m/s in materials above 2000 kg/m³."""

    poisson: Poisson
    """Poisson's ratio."""

    alpha_per_s: float = Field(ge=0)
    """Mass-proportional damping in 1/s."""

    beta_s: float = Field(ge=0)
    """Stiffness-proportional damping in s."""

    @model_validator(mode="after")
    def _is_a_solid(self):
        if wrong := pair_mistake(self.density_kg_m3, self.young_pa):
            raise ValueError(wrong)
        return self


class Sampled(Section):
    """Materials drawn at random for every object, in addition to the named ones; both bodies of an object share them.

    A material depends on the object's id, ``seed`` and its number, so a higher count keeps the earlier ones. Poisson's
    ratio is drawn uniformly, every other parameter log-uniformly.
    """

    count: int = Field(0, ge=0, le=10_000)
    """Number of materials for every object; they are named ``sampled-0000``, ``sampled-0001``, …"""

    seed: NonNegativeInt = 0
    """Seed of the draw; another seed gives other materials."""

    density_kg_m3: tuple[Density, Density] = (500.0, 10_000.0)
    """Range of the density in kg/m³."""

    young_pa: tuple[Young, Young] = (5e8, 5e11)
    """Range of Young's modulus in Pa."""

    poisson: tuple[Poisson, Poisson] = (0.1, 0.4)
    """Range of Poisson's ratio, within ``basis.poisson_range`` because these materials are never solved on the mesh."""

    alpha_per_s: tuple[PositiveFloat, PositiveFloat] = (0.5, 60.0)
    """Range of the mass-proportional damping in 1/s; the default is that of the table of materials."""

    beta_s: tuple[PositiveFloat, PositiveFloat] = (3e-8, 2e-6)
    """Range of the stiffness-proportional damping in s; the default is that of the table of materials."""

    @field_validator("density_kg_m3", "young_pa", "poisson", "alpha_per_s", "beta_s")
    @classmethod
    def _ascending(cls, value: tuple[float, float]) -> tuple[float, float]:
        return ascending(value)

    def ranges(self) -> dict[str, tuple[float, float]]:
        """Return the range of every parameter."""
        return self.model_dump(exclude={"count", "seed"})


class Basis(Section):
    """The material-independent modal basis."""

    order: Literal[1, 2] = 2
    """Element order: 1 (stiff, for comparison with published data) or 2."""

    modes: PositiveInt = 64
    """Number of elastic modes kept."""

    poisson_range: tuple[Poisson, Poisson] = (0.1, 0.4)
    """Range of Poisson's ratio for which the basis is valid."""

    max_error: float = Field(1e-5, gt=0, le=1e-2)
    """Largest estimated relative error that the basis may add to a frequency, anywhere in that range."""

    method: Literal["auto", "lanczos", "arpack", "lobpcg", "dense"] = "auto"
    """Eigensolver: ``auto`` means block Lanczos, or a dense solve for a tiny mesh."""

    factorisation: Literal["auto", "pardiso", "superlu"] = "auto"
    """Sparse factorisation: ``auto`` means PARDISO if it is installed, else SuperLU."""

    tolerance: float = Field(1e-3, gt=0, le=1e-2)
    """Largest residual ``‖K u - ω² M u‖ / ‖ω² M u‖`` of the sparse solve; the error of eigenvalues is about its
    square."""

    memory_mb: PositiveInt = 16000
    """Memory (address space) in MB for the solve; a body that needs more is refused."""

    @field_validator("poisson_range")
    @classmethod
    def _ascending(cls, value: tuple[float, float]) -> tuple[float, float]:
        return ascending(value)


class Modes(Section):
    """Frequencies, damping and mode shapes of every material."""

    corrected: bool = True
    """Whether the estimated discretisation error is removed from the frequencies (see docs/basis.md)."""

    tolerance: float = Field(1e-4, gt=0, le=1e-2)
    """Largest estimated relative error by the basis; a material above it is solved on the mesh."""

    memory_mb: PositiveInt = 16000
    """Memory (address space) in MB for such a solve; a body that needs more is refused."""


class MaterialModes(Modes):
    """Options of the stage ``modes`` for one object."""

    materials: dict[str, Material]
    """Materials by name."""

    sampled: Sampled = Sampled()
    """Materials drawn at random."""

    size_m: Size | None = None
    """Longest side of the bounding box in metres. Default: the size that the source states, else ``default_size_m``."""

    size_origin: str | None = None
    """Origin of ``size_m``: ``configuration`` or ``manifest``."""

    default_size_m: Size = 0.15
    """Longest side in metres if the source states none."""

    modes: PositiveInt = 64
    """Number of elastic modes kept."""

    def object_size(self, clean_record: dict) -> tuple[float, str]:
        """Return the longest side in metres and its origin: the configuration, else the source, else the default."""
        if self.size_m:
            return self.size_m, self.size_origin or "configuration"
        if clean_record.get("size_m"):
            return clean_record["size_m"], clean_record.get("size_origin") or "source"
        return self.default_size_m, "default"
