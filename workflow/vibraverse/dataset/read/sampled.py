"""Sampled materials in a reader: stored as arrays with one row per material, and read like named materials.

``frequencies_hz`` of the material ``sampled-0003`` is row 3 of ``sampled/frequencies_hz``; damping is not stored,
because it follows from the material and the frequencies.
"""

from __future__ import annotations

import numpy as np

from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.materials import sampled_name

#: Columns of the index, besides the name, in which the sampled materials of a body differ.
OWN = ("mass_kg", "f1_hz", "f_last_hz", "duration_s")


def read_sampled(body, name: str, number: int):
    """Return a material's field for a sampled material: a number or an array (m,).

    ``body`` is the HDF5 group of a body, ``name`` the field's name. Raises :class:`KeyError` for an unknown field.
    """
    rows = body["sampled"]
    if number >= len(rows["poisson"]):
        raise KeyError(sampled_name(number))
    if name in ("damping_per_s", "damped_frequencies_hz"):
        omega = 2 * np.pi * rows["frequencies_hz"][number]
        damping, damped = rayleigh_damping(omega, rows["alpha_per_s"][number], rows["beta_s"][number])
        return damping if name == "damping_per_s" else damped / (2 * np.pi)
    return rows[name][number]


def own_of(body) -> dict[str, np.ndarray]:
    """Return the index columns of a body's sampled materials: a column (n,) for each name of :data:`OWN`."""
    sounds, frequencies = body["sounds"], body["sampled/frequencies_hz"][()]
    names = map(sampled_name, range(len(frequencies)))
    durations = [float(sounds[name].attrs["duration_s"]) if name in sounds else 0.0 for name in names]
    return {
        "mass_kg": body["sampled/mass_kg"][()],
        "f1_hz": frequencies[:, 0],
        "f_last_hz": frequencies[:, -1],
        "duration_s": np.array(durations),
    }
