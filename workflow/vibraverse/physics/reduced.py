"""The modal basis of a body, and the reduced dense eigenproblem ``(λ A_λ + μ A_μ) c = ω² c`` for a material.

This module needs only NumPy and SciPy: no mesh, no finite elements. See :mod:`vibraverse.physics.basis` for the
construction of a basis, :mod:`vibraverse.physics.reduction` for its errors and :mod:`vibraverse.physics.enrichment` for
its corrections.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.physics.columns import lowest_pairs
from vibraverse.physics.materials import lame

#: Modes computed beyond those kept. Where branches of the spectrum cross, a mode above the last one kept at one ν is
#: kept at another ν, and corrections may lower it into the kept ones.
GUARD = 8
#: Smallest gap to unresolved modes that the error estimate assumes, as a share.
_MIN_GAP = 0.15


@dataclass(frozen=True)
class ModalBasis:
    """The modal basis of one body, in mesh units with E = ρ = 1.

    - ``a_lambda``, ``a_mu`` (r, r): reduced stiffness.
    - ``sketch`` (k, p, 3r): data of the error estimates, in the energy norms of ``energy_poisson`` (k,).
    - ``vertices`` (V, 3), ``faces`` (F, 3): the surface; ``surface`` (V, 3, r): the basis on its vertices.
    - ``correction_lambda``, ``correction_mu`` (r + m, m), ``correction_mass`` (r, m), ``correction_surface`` (V, 3, m):
      the corrections (:class:`vibraverse.physics.enrichment.Corrections`).
    - ``poisson_range`` (2,), and ``error``: the largest estimated relative error of a frequency in it.
    - ``poisson_nodes``: the ν of the sparse solve, then those of the corrections, in order.
    - ``residuals`` (m,) of the sparse solve.
    - ``volume``, ``centre`` (3,) and ``inertia`` (3, 3) about the centre, for unit density.

    The arrays on the surface are None if only frequencies are wanted.
    """

    a_lambda: np.ndarray
    a_mu: np.ndarray
    sketch: np.ndarray
    energy_poisson: np.ndarray
    vertices: np.ndarray | None
    faces: np.ndarray | None
    surface: np.ndarray | None
    correction_lambda: np.ndarray
    correction_mu: np.ndarray
    correction_mass: np.ndarray
    correction_surface: np.ndarray | None
    poisson_range: np.ndarray
    poisson_nodes: np.ndarray
    error: float
    residuals: np.ndarray
    volume: float
    centre: np.ndarray
    inertia: np.ndarray
    order: int
    n_vertices: int
    n_tetrahedra: int
    n_unknowns: int
    method: str
    factorisation: str


def solve_reduced(
    a_lambda: np.ndarray,
    a_mu: np.ndarray,
    sketch: np.ndarray,
    energy_poisson: np.ndarray,
    poisson: float,
    modes: int,
    guard: int = 0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve the reduced problem for E = ρ = 1.

    ``a_lambda`` and ``a_mu`` are (r, r). ``sketch`` (k, p, 3r) holds the products ``Yᵀ [K_λ U, K_μ U, M U]`` for each
    ν₀ in ``energy_poisson`` (k,); the nearest ν₀ is used. Returns ω̂² (m,), coefficients (r, m) and the estimated
    relative error (m,) of each frequency, for the ``modes`` lowest pairs and up to ``guard`` more.

    To first order a Ritz value exceeds the eigenvalue by ``‖r‖²`` in the norm of ``(K - ω²M)⁻¹`` on the complement of
    the basis. Every direction there is stiffer than the modes kept, so the energy norm times ``1 / (1 - ω²/ω²_next)``
    is an upper bound. The gap is taken as 0.15 at least, because the basis also resolves several modes above the last.
    """
    lam, mu = lame(1.0, poisson)
    wanted = min(modes + max(guard, 1), len(a_mu))
    values, vectors = lowest_pairs(lam * a_lambda + mu * a_mu, wanted)
    nearest = np.abs(np.log((1 - 2 * energy_poisson) / (1 - 2 * poisson))).argmin()
    residual = sketch[nearest] @ np.concatenate([lam * vectors, mu * vectors, -values * vectors])
    size = (residual**2).mean(axis=0)
    gap = 1.0 - values / values[modes] if wanted > modes else np.ones(wanted)
    error = 0.5 * size / values / np.maximum(gap, _MIN_GAP)
    kept = min(modes + guard, wanted)
    return values[:kept], vectors[:, :kept], error[:kept]


def solve_corrected(
    k_lambda: np.ndarray,
    k_mu: np.ndarray,
    mass: np.ndarray,
    poisson: float,
    values: np.ndarray,
    coefficients: np.ndarray,
    modes: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Solve the reduced problem with the corrections of :mod:`vibraverse.physics.enrichment`, for E = ρ = 1.

    ``values`` (q,) and ``coefficients`` (r, q) are the lowest uncorrected pairs, a few more than ``modes``. Returns ω̂²
    (q,), coefficients (r + m, modes), and the relative lowering of each frequency twice: (modes,) in the order of the
    corrected modes and (modes,) in that of the uncorrected ones.
    """
    lam, mu = lame(1.0, poisson)
    columns = lam * k_lambda + mu * k_mu
    rank, kept = coefficients.shape
    side, link = coefficients.T @ columns[:rank], coefficients.T @ mass
    stiffness = np.block([[np.diag(values), side], [side.T, columns[rank:]]])
    weight = np.block([[np.eye(kept), link], [link.T, np.eye(len(link.T))]])
    corrected, mixing = lowest_pairs(stiffness, kept, weight)
    # A mode without its corrections has the Rayleigh quotient of its uncorrected part.
    weights = mixing[:kept] ** 2
    lowered = np.sqrt(values @ weights / weights.sum(axis=0) / corrected) - 1.0
    lowered_here = (weights @ lowered / weights.sum(axis=1))[:modes]
    vectors = np.concatenate([coefficients @ mixing[:kept, :modes], mixing[kept:, :modes]])
    return corrected, vectors, lowered[:modes], lowered_here
