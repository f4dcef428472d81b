"""Sampled materials as a reader sees them: stored as arrays with a row each, read like any other material.

``frequencies_hz`` of the material ``sampled-0003`` is row 3 of ``sampled/frequencies_hz``; damping is not stored,
because it follows from the material and the frequencies.
"""

from __future__ import annotations

import numpy as np

from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.materials import sampled_name


def read_sampled(body, name: str, number: int):
    """Return what a field of a material is for a sampled one: a number or an array (m,).

    ``body`` is the HDF5 group of a body, ``name`` the field's. Raises :class:`KeyError` where it is not known.
    """
    rows = body["sampled"]
    if number >= len(rows["poisson"]):
        raise KeyError(sampled_name(number))
    if name in ("damping_per_s", "damped_frequencies_hz"):
        omega = 2 * np.pi * rows["frequencies_hz"][number]
        damping, damped = rayleigh_damping(omega, rows["alpha_per_s"][number], rows["beta_s"][number])
        return damping if name == "damping_per_s" else damped / (2 * np.pi)
    return rows[name][number]


def rows_of(body, row: dict) -> list[dict]:
    """Return the rows that the sampled materials of a body would have in the index; ``row`` is one of the body's."""
    sounds = body["sounds"]
    frequencies, mass = body["sampled/frequencies_hz"][()], body["sampled/mass_kg"][()]
    found = []
    for number, (hz, mass_kg) in enumerate(zip(frequencies, mass, strict=True)):
        name = sampled_name(number)
        duration_s = float(sounds[name].attrs["duration_s"]) if name in sounds else 0.0
        own = {"material": name, "mass_kg": float(mass_kg), "duration_s": duration_s}
        found.append({**row, **own, "f1_hz": float(hz[0]), "f_last_hz": float(hz[-1])})
    return found
