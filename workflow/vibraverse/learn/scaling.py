"""Scales of modal frequencies and materials: Hz, dimensionless, mel, and those that networks see.

A body of volume V in a material has ``ω̂ = ω V^(1/3) / sqrt(E/ρ)``. This depends on the shape and on Poisson's ratio
alone, so E, ρ and the size enter exactly.
"""

from __future__ import annotations

import numpy as np

#: The mel scale (O'Shaughnessy, Speech Communication, 1987): ``m(f) = 2595 log10(1 + f/700)``.
_MELS, _CORNER_HZ = 2595.0, 700.0


def unit_hz(volume_m3: np.ndarray, young_pa: np.ndarray, density_kg_m3: np.ndarray) -> np.ndarray:
    """Return the frequency in Hz that corresponds to ``ω̂ = 1``: ``sqrt(E/ρ) / V^(1/3) / 2π``."""
    return np.sqrt(young_pa / density_kg_m3) / np.cbrt(volume_m3) / (2 * np.pi)


def log_dimensionless(values: np.ndarray, volume: float) -> np.ndarray:
    """Return ``log ω̂`` of ω² for E = ρ = 1; ``volume`` is that of the body in the same unit of length."""
    return 0.5 * np.log(values) + np.log(volume) / 3.0


def mel(frequencies_hz: np.ndarray) -> np.ndarray:
    """Return frequencies on the mel scale."""
    return _MELS * np.log10(1.0 + frequencies_hz / _CORNER_HZ)


def from_mel(mels: np.ndarray) -> np.ndarray:
    """Return the frequencies in Hz of mels; the inverse of :func:`mel`."""
    return _CORNER_HZ * (10.0 ** (mels / _MELS) - 1.0)


#: Ends of the scaled mel scale in Hz; they become -1 and 1. Frequencies beyond leave that interval: clipping them would
#: put many targets at one point, which flatters the error.
LOWEST_HZ, HIGHEST_HZ = 20.0, 20_000.0
#: Ranges that become [-1, 1]: density in kg/m³ and Young's modulus in Pa by their logarithms, Poisson's ratio linearly.
_DENSITY, _YOUNG, _POISSON = (500.0, 1e4), (5e8, 5e11), (0.1, 0.4)


def scaled(frequencies_hz: np.ndarray) -> np.ndarray:
    """Return frequencies on the scaled mel scale, where 20 Hz is -1 and 20 kHz is 1."""
    return _scaled(mel(frequencies_hz), mel(LOWEST_HZ), mel(HIGHEST_HZ))


def unscaled(values: np.ndarray) -> np.ndarray:
    """Return the frequencies in Hz of values on the scaled mel scale; the inverse of :func:`scaled`."""
    low, high = mel(LOWEST_HZ), mel(HIGHEST_HZ)
    return from_mel(0.5 * (values + 1.0) * (high - low) + low)


def scaled_material(density_kg_m3, young_pa, poisson) -> np.ndarray:
    """Return materials (…, 3) as density, Young's modulus and Poisson's ratio, each scaled to [-1, 1]."""
    parts = (
        _scaled(np.log(density_kg_m3), *np.log(_DENSITY)),
        _scaled(np.log(young_pa), *np.log(_YOUNG)),
        _scaled(np.asarray(poisson), *_POISSON),
    )
    return np.stack(parts, axis=-1)


def _scaled(value, low, high):
    return 2.0 * (value - low) / (high - low) - 1.0
