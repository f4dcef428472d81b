"""The table of materials, their elastic constants, and materials drawn at random.

The values are those published with NeuralSound (Jin et al., 2022) and DiffSound (Jin et al., 2024). DiffSound lists
``alpha`` 10 for iron and 20 for steel.
"""

from __future__ import annotations

import re

from vibraverse.contract.seeds import rng

#: Parameters of a material: density, Young's modulus, Poisson's ratio, Rayleigh damping.
PARAMETERS = ("density_kg_m3", "young_pa", "poisson", "alpha_per_s", "beta_s")

_ROWS = {
    "ceramic": (2700.0, 7.2e10, 0.19, 6.0, 1e-7),
    "glass": (2600.0, 6.2e10, 0.20, 1.0, 1e-7),
    "wood": (750.0, 1.1e10, 0.25, 60.0, 2e-6),
    "plastic": (1070.0, 1.4e9, 0.35, 30.0, 1e-6),
    "iron": (8000.0, 2.1e11, 0.28, 5.0, 1e-7),
    "polycarbonate": (1190.0, 2.4e9, 0.37, 0.5, 4e-7),
    "steel": (7850.0, 2.0e11, 0.29, 5.0, 3e-8),
    "tin": (7265.0, 5.0e10, 0.325, 2.0, 3e-8),
}

_SAMPLED = re.compile(r"sampled-(\d{4,})")

#: Name -> density in kg/m³, Young's modulus in Pa, Poisson's ratio, damping alpha in 1/s and beta in s.
MATERIALS: dict[str, dict[str, float]] = {
    name: dict(zip(PARAMETERS, row, strict=True)) for name, row in _ROWS.items()
}


def lame(young: float, poisson: float) -> tuple[float, float]:
    """Return Lamé's ``(λ, μ)`` of a material, in the unit of ``young``."""
    return young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))


def sampled_name(number: int) -> str:
    """Return the name of an object's sampled material."""
    return f"sampled-{number:04d}"


def sampled_number(name: str) -> int | None:
    """Return the number of the sampled material with a name, None for other names."""
    found = _SAMPLED.fullmatch(name)
    return int(found[1]) if found and sampled_name(int(found[1])) == name else None


def sampled(object_id: str, seed: int, count: int, ranges: dict) -> dict:
    """Return ``count`` sampled materials of an object: for each parameter an array (count,) within its range.

    ``ranges`` holds (lowest, highest) by parameter. Poisson's ratio is drawn uniformly, the others log-uniformly.
    Material k depends only on id, seed and k.
    """
    return drawn(rng(object_id, "materials", str(seed)), count, ranges)


def drawn(random, count: int, ranges: dict) -> dict:
    """Return materials as :func:`sampled` does, drawn from a NumPy generator."""
    # Drawn row by row, so that a higher count starts with the same rows.
    places = random.random((count, len(PARAMETERS))).T
    found = {}
    for name, place in zip(PARAMETERS, places, strict=True):
        low, high = ranges[name]
        found[name] = low + (high - low) * place if name == "poisson" else low * (high / low) ** place
    return found
