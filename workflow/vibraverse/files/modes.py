"""Reading ``modes.h5``, and the same layout inside a shard of the dataset."""

from __future__ import annotations

import numpy as np

from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.materials import sampled_number
from vibraverse.physics.shapes import mode_shapes


def read_spectrum(h5, material: str) -> tuple:
    """Return frequencies in Hz (m,) and decay rates in 1/s (m,) of a material, named or sampled.

    ``h5`` is an open modes.h5, or the group of a body in a shard, which has the same layout. Raises :class:`KeyError`
    if the material does not exist.
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


def read_surface(h5, vertices=None) -> tuple[np.ndarray, np.ndarray]:
    """Return the basis (V, 3, r) and its corrections (V, 3, c) on the surface, from which mode shapes are combined.

    ``h5`` is an open basis.h5, or the same group of a body in a shard; ``vertices`` selects some vertices.
    """

    arrays = h5["surface/basis"], h5["correction/surface"]
    if vertices is None:
        return tuple(array[()] for array in arrays)
    ascending, places = np.unique(vertices, return_inverse=True)  # HDF5 selects in ascending order
    return tuple(array[ascending][places] for array in arrays)


def read_mode_shapes(h5, surface: tuple, material: str, vertices=None) -> np.ndarray:
    """Return the mode shapes (m, V, 3) of a named material in kg^(-1/2), float32.

    ``h5`` is as for :func:`read_spectrum`; ``surface`` is the result of :func:`read_surface` for the same ``vertices``.
    Raises :class:`KeyError` if the material does not exist.
    """
    group = h5["materials"][material]
    if "mode_shapes" in group:  # solved on the mesh itself
        shapes = group["mode_shapes"][()]
        return shapes if vertices is None else shapes[:, vertices]
    return mode_shapes(*surface, group["mode_coefficients"][()])
