"""What no solid is and no object of this kind has: numbers in which a unit was mistaken, said with the likely one.

The bounds are wide on purpose. Foams, aerogels, gels and rubbers lie inside, and diamond, osmium and carbon fibres do;
what lies outside was mistyped or given in another unit.
"""

from __future__ import annotations

import math

#: Density in kg/m³: lighter than air there is no solid, since its pores hold some; osmium has 22,590.
DENSITY_KG_M3 = (1.0, 25_000.0)
#: Young's modulus in Pa: a body of a decimetre flattens under its own weight below; diamond has 1.1e12.
YOUNG_PA = (1e3, 1.5e12)
#: Speed of sound ``√(E/ρ)`` in a thin bar in m/s: carbon nanotubes reach 22,000, theory allows 36,000, and
#: the default ranges of sampled materials contain 31,600.
FASTEST_M_S = 35_000.0
#: The least such speed in what is denser than this: silicone full of tungsten has 15 m/s, metals and ceramics whose MPa
#: were taken for Pa have 1 to 12.
DENSE_KG_M3, SLOWEST_DENSE_M_S = 2000.0, 12.0
#: Longest side in metres.
SIZE_M = (1e-3, 50.0)


def density_mistake(density_kg_m3: float) -> str:
    """Return what is wrong with a density, with the unit that was probably meant; empty when nothing is."""
    low, high = DENSITY_KG_M3
    if density_kg_m3 < low:
        meant = _meant(density_kg_m3, "g/cm³", 1e3, DENSITY_KG_M3) or f"write kg/m³, at least {low:g}"
        return f"{density_kg_m3:g} kg/m³ is lighter than air; {meant}"
    if density_kg_m3 > high:
        return f"{density_kg_m3:g} kg/m³ is heavier than any solid; write kg/m³, at most {high:g}"
    return ""


def young_mistake(young_pa: float) -> str:
    """Return what is wrong with a Young's modulus, with the unit that was probably meant; empty when nothing is."""
    low, high = YOUNG_PA
    if young_pa < low:
        meant = _meant(young_pa, "GPa", 1e9, YOUNG_PA) or f"write Pa, at least {low:g}"
        return f"{young_pa:g} Pa is softer than any solid; {meant}"
    if young_pa > high:
        return f"{young_pa:g} Pa is stiffer than any solid; write Pa, at most {_written(high)}"
    return ""


def pair_mistake(density_kg_m3: float, young_pa: float) -> str:
    """Return why density and Young's modulus cannot be those of one solid; empty when they can."""
    speed_m_s = math.sqrt(young_pa / density_kg_m3)
    if density_kg_m3 > DENSE_KG_M3 and speed_m_s < SLOWEST_DENSE_M_S:
        meant = _meant(young_pa, "MPa", 1e6, YOUNG_PA) or "check both units"
        return (
            f"density_kg_m3 {density_kg_m3:g} and young_pa {young_pa:g} are not of one solid, sound would travel at "
            f"{speed_m_s:.1f} m/s and is faster than {SLOWEST_DENSE_M_S:g} in all that is so dense; {meant}"
        )
    if speed_m_s <= FASTEST_M_S:
        return ""
    lightest = young_pa / FASTEST_M_S**2
    meant = _meant(density_kg_m3, "g/cm³", 1e3, (lightest, DENSITY_KG_M3[1]))
    return (
        f"density_kg_m3 {density_kg_m3:g} and young_pa {young_pa:g} are not of one solid, sound would travel at "
        f"{speed_m_s / 1e3:.0f} km/s and nowhere exceeds {FASTEST_M_S / 1e3:.0f}; {meant or 'check both units'}"
    )


def size_mistake(size_m: float) -> str:
    """Return what is wrong with the longest side of an object, with the unit probably meant; empty when nothing is."""
    low, high = SIZE_M
    if size_m < low:
        return f"{size_m:g} m is less than the {low:g} m that an object may have; write metres"
    if size_m > high:
        meant = _meant(size_m, "mm", 1e-3, SIZE_M) or "write metres"
        return f"{size_m:g} m is more than the {high:g} m that an object may have; {meant}"
    return ""


def _meant(value: float, unit: str, factor: float, bounds: tuple[float, float]) -> str:
    """Return how a value in another unit is written; empty where that would not be plausible either."""
    low, high = bounds
    return f"write {_written(factor * value)} for {value:g} {unit}" if low <= factor * value <= high else ""


def _written(value: float) -> str:
    """Return a number as YAML takes it for one: with a dot before the exponent."""
    digits, exponent, power = f"{value:g}".partition("e")
    return f"{digits}.0e{power}" if exponent and "." not in digits else f"{digits}{exponent}{power}"
