"""The table of materials.

Values are the sets published with NeuralSound (Jin et al., 2022) and DiffSound (Jin et al., 2024);
DiffSound lists ``alpha`` 10 for iron and 20 for steel.
"""

from __future__ import annotations

_COLUMNS = ("density_kg_m3", "young_pa", "poisson", "alpha_per_s", "beta_s")

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

#: Name -> density in kg/m³, Young's modulus in Pa, Poisson's ratio, damping alpha in 1/s and beta in s.
MATERIALS: dict[str, dict[str, float]] = {
    name: dict(zip(_COLUMNS, row, strict=True)) for name, row in _ROWS.items()
}
