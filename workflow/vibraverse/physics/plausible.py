"""Plausible ranges of densities, Young's moduli and sizes; outside them a unit was probably mistaken.

The bounds are wide on purpose. They include foams, aerogels, gels and rubbers as well as diamond, osmium and carbon
fibres. Values outside were mistyped or given in another unit, and the messages name the likely one.
"""

from __future__ import annotations

import math

#: Density in kg/m³: no solid is lighter than the air in its pores; osmium has 22,590.
DENSITY_KG_M3 = (1.0, 25_000.0)
#: Young's modulus in Pa: below, a body of a decimetre flattens under its own weight; diamond has 1.1e12.
YOUNG_PA = (1e3, 1.5e12)
#: Largest speed of sound ``√(E/ρ)`` in a thin bar in m/s: carbon nanotubes reach 22,000, theory allows 36,000, and the
#: default ranges of sampled materials include 31,600.
MAX_SPEED_M_S = 35_000.0
#: Smallest such speed in materials above this density: silicone filled with tungsten has 15 m/s; metals and ceramics
#: with MPa mistaken for Pa have 1 to 12.
DENSE_KG_M3, MIN_DENSE_SPEED_M_S = 2000.0, 12.0
#: Longest side in metres.
SIZE_M = (1e-3, 50.0)


def density_mistake(density_kg_m3: float) -> str:
    """Return the mistake in a density with the unit that was probably meant, or an empty string."""
    low, high = DENSITY_KG_M3
    if density_kg_m3 < low:
        meant = _meant(density_kg_m3, "g/cm³", 1e3, DENSITY_KG_M3) or f"write kg/m³, at least {low:g}"
        return f"{density_kg_m3:g} kg/m³ is lighter than air; {meant}"
    if density_kg_m3 > high:
        return f"{density_kg_m3:g} kg/m³ is heavier than any solid; write kg/m³, at most {high:g}"
    return ""


def young_mistake(young_pa: float) -> str:
    """Return the mistake in a Young's modulus with the unit that was probably meant, or an empty string."""
    low, high = YOUNG_PA
    if young_pa < low:
        meant = _meant(young_pa, "GPa", 1e9, YOUNG_PA) or f"write Pa, at least {low:g}"
        return f"{young_pa:g} Pa is softer than any solid; {meant}"
    if young_pa > high:
        return f"{young_pa:g} Pa is stiffer than any solid; write Pa, at most {_written(high)}"
    return ""


def pair_mistake(density_kg_m3: float, young_pa: float) -> str:
    """Return why density and Young's modulus cannot belong to one solid, or an empty string."""
    speed_m_s = math.sqrt(young_pa / density_kg_m3)
    if density_kg_m3 > DENSE_KG_M3 and speed_m_s < MIN_DENSE_SPEED_M_S:
        meant = _meant(young_pa, "MPa", 1e6, YOUNG_PA) or "check both units"
        return (
            f"density_kg_m3 {density_kg_m3:g} and young_pa {young_pa:g} are not of one solid, sound would travel at "
            f"{speed_m_s:.1f} m/s and is faster than {MIN_DENSE_SPEED_M_S:g} in all that is so dense; {meant}"
        )
    if speed_m_s <= MAX_SPEED_M_S:
        return ""
    lightest = young_pa / MAX_SPEED_M_S**2
    meant = _meant(density_kg_m3, "g/cm³", 1e3, (lightest, DENSITY_KG_M3[1]))
    return (
        f"density_kg_m3 {density_kg_m3:g} and young_pa {young_pa:g} are not of one solid, sound would travel at "
        f"{speed_m_s / 1e3:.0f} km/s and nowhere exceeds {MAX_SPEED_M_S / 1e3:.0f}; {meant or 'check both units'}"
    )


def size_mistake(size_m: float) -> str:
    """Return the mistake in the longest side of an object with the unit probably meant, or an empty string."""
    low, high = SIZE_M
    if size_m < low:
        return f"{size_m:g} m is less than the {low:g} m that an object may have; write metres"
    if size_m > high:
        meant = _meant(size_m, "mm", 1e-3, SIZE_M) or "write metres"
        return f"{size_m:g} m is more than the {high:g} m that an object may have; {meant}"
    return ""


def _meant(value: float, unit: str, factor: float, bounds: tuple[float, float]) -> str:
    """Return the advice to convert a value from another unit, or an empty string if that is not plausible either."""
    low, high = bounds
    return f"write {_written(factor * value)} for {value:g} {unit}" if low <= factor * value <= high else ""


def _written(value: float) -> str:
    """Return a number as YAML reads it: with a dot before the exponent."""
    digits, exponent, power = f"{value:g}".partition("e")
    return f"{digits}.0e{power}" if exponent and "." not in digits else f"{digits}{exponent}{power}"
