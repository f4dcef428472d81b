"""Frequencies, damping and mode shapes of any material, from the modal basis.

``(λ(ν) A_λ + μ(ν) A_μ) c = ω̂² c`` for E = ρ = 1, then ``ω = ω̂ sqrt(E/ρ) / s`` with s metres per mesh unit.
Rayleigh damping ``D = αM + βK`` gives ``d = ½(α + β ω²)`` and the damped frequency ``ω_d = sqrt(ω² - d²)``; a mode with
``d >= ω`` does not ring, and its damped frequency is 0. With the corrections of :mod:`vibraverse.physics.enrichment`
most of the elements' own error is removed from the frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.physics.columns import fix_signs
from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.materials import lame
from vibraverse.physics.reduced import GUARD, ModalBasis, solve_corrected, solve_reduced

#: What corrections leave of the elements' error, as a share of what they remove: near the largest seen
#: (benchmarks/accuracy.py), so that the estimate errs on the safe side.
_LEFT = 0.25


@dataclass(frozen=True)
class MaterialModes:
    """The modes of one body in one material, ascending.

    ``frequencies_hz`` (m,) undamped; ``damped_frequencies_hz`` (m,), 0 where overdamped; ``damping_per_s`` (m,);
    ``relative_error`` (m,) estimated relative error of each frequency by the reduction to the basis;
    ``discretisation_error`` (m,) estimated relative error by the elements; ``coefficients`` (m, r), or (m, r + c) with
    corrections, the mode shapes in the basis, mass-normalised, in kg^(-1/2) (see :mod:`vibraverse.physics.shapes`).
    ``following_hz`` is the frequency of the next mode, not kept: where it is that of the last one, the cut goes
    through a multiplet; it is 0 where the mesh has no more.
    """

    frequencies_hz: np.ndarray
    damped_frequencies_hz: np.ndarray
    damping_per_s: np.ndarray
    relative_error: np.ndarray
    discretisation_error: np.ndarray
    coefficients: np.ndarray
    following_hz: float
    mass_kg: float


def solve_material(
    basis: ModalBasis, material: dict, scale_m: float, modes: int, corrected: bool = True
) -> MaterialModes:
    """Return the modes of a body in a material.

    ``material`` holds ``density_kg_m3``, ``young_pa``, ``poisson``, ``alpha_per_s`` and ``beta_s``; ``scale_m`` is
    metres per mesh unit; at most as many modes as the basis was built for are returned. Without ``corrected`` the
    frequencies are those of the mesh's elements as they are. The basis may lack its surface.
    """
    young, density = material["young_pa"], material["density_kg_m3"]
    modes = min(modes, len(basis.residuals))
    reduced = reduced_solve(basis, material["poisson"], modes, corrected)
    to_hz = np.sqrt(young / density) / scale_m / (2 * np.pi)
    omega = 2 * np.pi * to_hz * np.sqrt(reduced.values)
    damping, damped = rayleigh_damping(omega, material["alpha_per_s"], material["beta_s"])
    return MaterialModes(
        frequencies_hz=omega / (2 * np.pi),
        damped_frequencies_hz=damped / (2 * np.pi),
        damping_per_s=damping,
        relative_error=reduced.relative_error,
        discretisation_error=reduced.discretisation_error,
        # The basis is normalised for unit density and unit scale; ρ s³ turns that mass into kilograms.
        coefficients=reduced.coefficients.T / np.sqrt(density * scale_m**3),
        following_hz=float(to_hz * np.sqrt(reduced.following)),
        mass_kg=density * basis.volume * scale_m**3,
    )


def solve_materials(
    basis: ModalBasis, materials: dict[str, np.ndarray], scale_m: float, modes: int, corrected: bool = True
) -> dict[str, np.ndarray]:
    """Return frequencies and errors of many materials, whose parameters are arrays (n,); some milliseconds each.

    ``frequencies_hz``, ``relative_error`` and ``discretisation_error`` (n, m), ``mass_kg`` (n,), as in
    :class:`MaterialModes`.
    """
    found = [
        solve_material(basis, dict(zip(materials, row, strict=True)), scale_m, modes, corrected)
        for row in zip(*materials.values(), strict=True)
    ]
    names = ("frequencies_hz", "relative_error", "discretisation_error", "mass_kg")
    return {name: np.array([getattr(one, name) for one in found]) for name in names}


def departure(
    basis: ModalBasis, material: dict, scale_m: float, frequencies_hz: np.ndarray, coefficients: np.ndarray
) -> np.ndarray:
    """Return by how much (m,) coefficients (m, q) fail to be modes of these frequencies (m,), as a share.

    Modes are orthonormal in the mass and orthogonal in the stiffness, which gives every one its ``ω²``; for each mode
    it is the largest difference from that, of the mass or of the larger ``ω²`` of the two.
    """
    young, density, poisson = (material[name] for name in ("young_pa", "density_kg_m3", "poisson"))
    lam, mu = lame(1.0, poisson)
    rank, size = len(basis.a_mu), coefficients.shape[1]
    mass, stiffness = np.eye(size), np.empty((size, size))
    stiffness[:rank, :rank] = lam * basis.a_lambda + mu * basis.a_mu
    if size > rank:
        mass[:rank, rank:], mass[rank:, :rank] = basis.correction_mass, basis.correction_mass.T
        stiffness[:, rank:] = lam * basis.correction_lambda + mu * basis.correction_mu
        stiffness[rank:, :rank] = stiffness[:rank, rank:].T
    unscaled = coefficients * np.sqrt(density * scale_m**3)
    squares = (2 * np.pi * frequencies_hz * scale_m) ** 2 * density / young
    larger = np.maximum(squares, squares[:, None])
    of_mass = unscaled @ mass @ unscaled.T - np.eye(len(squares))
    of_stiffness = (unscaled @ stiffness @ unscaled.T - np.diag(squares)) / larger
    return np.maximum(np.abs(of_mass), np.abs(of_stiffness)).max(axis=1)


@dataclass(frozen=True)
class ReducedModes:
    """Pairs for E = ρ = 1: ``values`` ω̂² (m,), ``coefficients`` (r, m), or (r + c, m) with corrections.

    ``relative_error`` and ``discretisation_error`` (m,) as in :class:`MaterialModes`; ``following`` is the next ω̂², 0
    where the mesh has no more.
    """

    values: np.ndarray
    following: float
    coefficients: np.ndarray
    relative_error: np.ndarray
    discretisation_error: np.ndarray


def reduced_solve(basis: ModalBasis, poisson: float, modes: int, corrected: bool = True) -> ReducedModes:
    """Return the lowest pairs of a body for E = ρ = 1."""
    values, vectors, error = solve_reduced(
        basis.a_lambda, basis.a_mu, basis.sketch, basis.energy_poisson, poisson, modes, GUARD
    )
    lower, mixed, lowered, lowered_here = solve_corrected(
        basis.correction_lambda, basis.correction_mu, basis.correction_mass, poisson, values, vectors, modes
    )
    found = lower if corrected else values
    following = float(found[modes]) if len(found) > modes else 0.0
    if corrected:
        return ReducedModes(lower[:modes], following, fix_signs(mixed), error[:modes], _LEFT * lowered)
    return ReducedModes(values[:modes], following, fix_signs(vectors[:, :modes]), error[:modes], lowered_here)
