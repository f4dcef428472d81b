"""Reading ``modes.h5``, and the same layout inside a shard of the dataset."""

from __future__ import annotations

import numpy as np

from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.materials import sampled_number


def read_spectrum(h5, material: str) -> tuple:
    """Return frequencies in Hz (m,) and decay rates in 1/s (m,) of a material, named or sampled.

    ``h5`` is an open modes.h5, or the group of a body in a shard, which has its layout.

    Raises :class:`KeyError` where there is no such material.
    """
    number = sampled_number(material)
    if number is None:
        group = h5["materials"][material]
        return group["frequencies_hz"][()], group["damping_per_s"][()]
    if "sampled" not in h5 or number >= len(h5["sampled/poisson"]):
        raise KeyError(material)
    frequencies = h5["sampled/frequencies_hz"][number]
    alpha, beta = (h5[f"sampled/{key}"][number] for key in ("alpha_per_s", "beta_s"))
    return frequencies, rayleigh_damping(2 * np.pi * frequencies, alpha, beta)[0]
