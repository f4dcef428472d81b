"""The valid ranges of fields, written as intervals: ``(0, ∞)`` is open, ``[0, 1]`` includes its ends.

All numbers must also be finite; a field that is not listed may have any finite value.
"""

from __future__ import annotations

import math

import numpy as np

#: Field -> interval.
RANGES: dict[str, str] = {
    "surface_vertices": "[-1, 1]",
    "surface_faces": "[0, ∞)",
    "moments": "(0, ∞)",
    "spectrum": "(0, ∞)",
    "coarse_vertices": "[-1, 1]",
    "coarse_faces": "[0, ∞)",
    "occupancy": "[0, 1]",
    "signed_distance": "[-1, 4]",
    "azimuth_deg": "[-360, 360]",
    "elevation_deg": "[-90, 90]",
    "size_m": "(0, ∞)",
    "scale_m": "(0, ∞)",
    "volume_m3": "(0, ∞)",
    "boundary_vertices": "[-1, 1]",
    "boundary_faces": "[0, ∞)",
    "tet_points": "[-1, 1]",
    "tet_cells": "[0, ∞)",
    "residuals": "[0, ∞)",
    "poisson_range": "(-1, 0.5)",
    "poisson_nodes": "(-1, 0.5)",
    "basis_error": "[0, ∞)",
    "vertices": "[-1, 1]",
    "faces": "[0, ∞)",
    "centre": "[-1, 1]",
    "basis_volume": "(0, 8]",
    "energy_poisson": "(-1, 0.5)",
    "order": "[1, 2]",
    "n_vertices": "(0, ∞)",
    "n_tetrahedra": "(0, ∞)",
    "n_unknowns": "(0, ∞)",
    "density_kg_m3": "(0, ∞)",
    "young_pa": "(0, ∞)",
    "poisson": "(-1, 0.5)",
    "alpha_per_s": "[0, ∞)",
    "beta_s": "[0, ∞)",
    "mass_kg": "(0, ∞)",
    "following_hz": "[0, ∞)",
    "frequencies_hz": "(0, ∞)",
    "damping_per_s": "[0, ∞)",
    "damped_frequencies_hz": "[0, ∞)",
    "relative_error": "[0, ∞)",
    "discretisation_error": "[0, ∞)",
    "sound": "[-1, 1]",
    "sample_rate_hz": "[8000, 192000]",
    "duration_s": "(0, ∞)",
    "gain": "(0, ∞)",
}


RANGES |= {
    f"sampled_{name}": RANGES[name]
    for name in (
        "density_kg_m3", "young_pa", "poisson", "alpha_per_s", "beta_s", "mass_kg", "frequencies_hz", "relative_error",
        "discretisation_error",
    )
}  # fmt: skip


def outside(name: str, value) -> str:
    """Return what is wrong with the numbers of a field, as ``holds 3 numbers outside (0, ∞)``; "" if nothing is."""
    array = np.asarray(value)
    if array.dtype.kind == "f":
        infinite = np.count_nonzero(~np.isfinite(array))
        if infinite:
            return f"holds {infinite} numbers that are not finite"
    if name not in RANGES or not array.size:
        return ""
    interval = RANGES[name]
    low, high = (float(end.replace("∞", "inf")) for end in interval[1:-1].split(", "))
    least, most = array.min(), array.max()
    above = least > low if interval[0] == "(" else least >= low
    below = most < high if interval[-1] == ")" and not math.isinf(high) else most <= high
    return "" if above and below else f"holds numbers from {least:g} to {most:g}, outside {interval}"
