"""Frequencies, damping and mode shapes of any material, from the modal basis.

``(λ(ν) A_λ + μ(ν) A_μ) c = ω̂² c`` for E = ρ = 1, then ``ω = ω̂ sqrt(E/ρ) / s`` with s metres per mesh unit.
Rayleigh damping ``D = αM + βK`` gives ``d = ½(α + β ω²)`` and the damped frequency ``ω_d = sqrt(ω² - d²)``; a mode with
``d >= ω`` does not ring, and its damped frequency is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.physics.basis import ModalBasis
from vibraverse.physics.eigensolver import fix_signs
from vibraverse.physics.reduction import solve_reduced


@dataclass(frozen=True)
class MaterialModes:
    """The modes of one body in one material, ascending.

    ``frequencies_hz`` (m,) undamped; ``damped_frequencies_hz`` (m,), 0 where overdamped; ``damping_per_s`` (m,);
    ``relative_error`` (m,) estimated relative error of each frequency by the reduction to the basis;
    ``mode_shapes`` (m, V, 3) at the surface vertices, mass-normalised, in kg^(-1/2).
    """

    frequencies_hz: np.ndarray
    damped_frequencies_hz: np.ndarray
    damping_per_s: np.ndarray
    relative_error: np.ndarray
    mode_shapes: np.ndarray
    mass_kg: float


def rayleigh_damping(omega: np.ndarray, alpha: float, beta: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ``d`` in 1/s and ``ω_d`` in rad/s (0 where overdamped) for angular frequencies in rad/s."""
    damping = 0.5 * (alpha + beta * omega**2)
    return damping, np.sqrt(np.maximum(omega**2 - damping**2, 0.0))


def solve_material(basis: ModalBasis, material: dict, scale_m: float, modes: int) -> MaterialModes:
    """Return the modes of a body in a material.

    ``material`` holds ``density_kg_m3``, ``young_pa``, ``poisson``, ``alpha_per_s`` and ``beta_s``; ``scale_m`` is
    metres per mesh unit; at most as many modes as the basis was built for are returned.
    """
    young, density = material["young_pa"], material["density_kg_m3"]
    modes = min(modes, len(basis.residuals))
    values, coefficients, error = reduced_solve(basis, material["poisson"], modes)
    omega = np.sqrt(values * young / density) / scale_m
    damping, damped = rayleigh_damping(omega, material["alpha_per_s"], material["beta_s"])
    mass_kg = density * basis.volume * scale_m**3
    shapes = np.einsum("var,rm->mva", basis.surface, coefficients, optimize=True)
    return MaterialModes(
        frequencies_hz=omega / (2 * np.pi),
        damped_frequencies_hz=damped / (2 * np.pi),
        damping_per_s=damping,
        relative_error=error,
        # The basis is normalised for unit density and unit scale; ρ s³ turns that mass into kilograms.
        mode_shapes=shapes / np.sqrt(density * scale_m**3),
        mass_kg=mass_kg,
    )


def reduced_solve(basis: ModalBasis, poisson: float, modes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ω̂² (m,), coefficients (r, m) and estimated relative frequency errors (m,) for E = ρ = 1."""
    values, vectors, error = solve_reduced(
        basis.a_lambda, basis.a_mu, basis.sketch, basis.energy_poisson, poisson, modes
    )
    return values, fix_signs(vectors), error
