"""Frequencies, damping and mode shapes in any material, from the modal basis.

First ``(λ(ν) A_λ + μ(ν) A_μ) c = ω̂² c`` is solved for E = ρ = 1; then ``ω = ω̂ sqrt(E/ρ) / s`` with s metres per mesh
unit. Rayleigh damping ``D = αM + βK`` gives ``d = ½(α + β ω²)`` and the damped frequency ``ω_d = sqrt(ω² - d²)``. A
mode with ``d >= ω`` does not ring, and its damped frequency is 0. The corrections of
:mod:`vibraverse.physics.enrichment` remove most of the discretisation error from the frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.physics.columns import fix_signs
from vibraverse.physics.damping import rayleigh_damping
from vibraverse.physics.materials import lame
from vibraverse.physics.reduced import GUARD, ModalBasis, solve_corrected, solve_reduced

#: Discretisation error after the corrections, as a share of what they remove. It is close to the largest share found
#: by benchmarks/accuracy.py, so the estimate is conservative.
_REMAINING_SHARE = 0.25


@dataclass(frozen=True)
class MaterialModes:
    """The modes of one body in one material, ascending.

    ``frequencies_hz`` (m,) are undamped, ``damped_frequencies_hz`` (m,) are 0 where overdamped, and ``damping_per_s``
    (m,) are decay rates. ``relative_error`` (m,) is the estimated relative error of each frequency by the reduction to
    the basis, ``discretisation_error`` (m,) that by the elements. ``coefficients`` (m, r), or (m, r + c) with
    corrections, are the mass-normalised mode shapes in the basis in kg^(-1/2) (see :mod:`vibraverse.physics.shapes`).
    ``following_hz`` is the frequency of the next mode, which is not kept, or 0 if the mesh has none. If it equals the
    last one, the cut goes through a multiplet.
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
    metres per mesh unit. At most as many modes are returned as the basis was built for. Without ``corrected`` the
    frequencies include the discretisation error. The basis may lack its surface.
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
    """Return frequencies and errors in many materials, whose parameters are arrays (n,); some milliseconds each.

    ``frequencies_hz``, ``relative_error`` and ``discretisation_error`` are (n, m) and ``mass_kg`` is (n,), as in
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
    """Return the relative departure (m,) of coefficients (m, q) from modes with the given frequencies (m,).

    Modes are M-orthonormal and K-orthogonal with ``ω²`` on the diagonal. For each mode this is the largest departure
    from either, where that from the stiffness is relative to the larger ``ω²`` of the pair.
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

    ``relative_error`` and ``discretisation_error`` (m,) are as in :class:`MaterialModes`. ``following`` is the next
    ω̂², or 0 if the mesh has none.
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
        return ReducedModes(
            lower[:modes], following, fix_signs(mixed), error[:modes], _REMAINING_SHARE * lowered
        )
    return ReducedModes(values[:modes], following, fix_signs(vectors[:, :modes]), error[:modes], lowered_here)
