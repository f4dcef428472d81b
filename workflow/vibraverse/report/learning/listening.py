"""True and predicted spectra as sounds that differ in nothing but their frequencies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from vibraverse.contract.seeds import stable_hash
from vibraverse.learn.metrics import LOWEST
from vibraverse.learn.scaling import unit_hz
from vibraverse.media.audio import PEAK_DBFS
from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.impulse import impact_sound

#: Samples per second, and the length of the longest sound in seconds.
SAMPLE_RATE_HZ, LONGEST_S = 44_100, 1.5
#: A body is hardly heard if its first mode is higher, or falls by 60 dB in less time.
_HIGHEST_HZ, _SHORTEST_S = 12_000.0, 0.3


def is_heard(true_hz: np.ndarray, material: Mapping[str, float]) -> bool:
    """Return whether the first mode of frequencies (m,) is low enough, and rings long enough, to be heard well."""
    damping, _ = rayleigh_damping(2 * np.pi * true_hz[0], material["alpha_per_s"], material["beta_s"])
    return bool(true_hz[0] < _HIGHEST_HZ and math.log(1000.0) > damping * _SHORTEST_S)


def chosen(
    bodies: Iterable[str], materials: Sequence[str], heard: Callable[[str, str], bool], count: int
) -> list[tuple[str, str]]:
    """Return some bodies, each with a material, by hashes of their names: more bodies change few of those chosen.

    What is hardly heard, as ``heard(body, material)`` says, is chosen last.
    """

    def place(body: str, material: str) -> tuple[bool, int]:
        return not heard(body, material), stable_hash(body, material, "listen")

    found = [(body, min(materials, key=lambda name: place(body, name))) for body in bodies]
    return sorted(found, key=lambda one: place(*one))[:count]


def sounds(
    true_hz: np.ndarray, found: Mapping[str, np.ndarray], material: Mapping[str, float]
) -> dict[str, np.ndarray]:
    """Return the samples of the truth, named "", and of each prediction (m,), all at one loudness scale.

    The decay rate and the amplitude of a mode are those of the true one in the dataset's impact sound, so only
    frequencies differ. A prediction so low that it would not ring with that decay is left out.
    """
    omega = 2 * np.pi * true_hz
    damping, ringing = rayleigh_damping(omega, material["alpha_per_s"], material["beta_s"])
    made = {"": _sound(true_hz, damping, None)}
    for name, hz in found.items():
        hz = np.maximum(hz, LOWEST)
        own = np.sqrt(np.maximum((2 * np.pi * hz) ** 2 - damping**2, 0.0))
        # The amplitude of a mode that rings is its weight over its ringing frequency; other modes keep their weight.
        weights = np.divide(own, ringing, out=np.ones_like(own), where=ringing > 0)
        made[name] = _sound(hz, damping, weights)
    peak = max(float(np.abs(samples).max()) for samples in made.values())
    scale = 10.0 ** (PEAK_DBFS / 20.0) / peak if peak > 0 else 1.0
    return {name: scale * samples for name, samples in made.items()}


def _sound(hz: np.ndarray, damping: np.ndarray, weights: np.ndarray | None) -> np.ndarray:
    return impact_sound(hz, damping, SAMPLE_RATE_HZ, max_s=LONGEST_S, weights=weights).samples


def mean_log_omega(samples, bodies: Iterable[int]) -> np.ndarray:
    """Return the mean (m,) of the logarithms of the dimensionless frequencies of bodies in all their materials."""
    young, density = (
        np.array([one[name] for one in samples.materials.values()]) for name in ("young_pa", "density_kg_m3")
    )
    total, count = 0.0, 0
    for body in bodies:
        unit = unit_hz(samples.row("volume_m3", body), young, density)
        total = total + np.log(samples.row("frequencies_hz", body) / unit[:, None]).mean(axis=0)
        count += 1
    return total / count
