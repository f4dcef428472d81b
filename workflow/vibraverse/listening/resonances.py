"""The frequencies of a body as functions of Poisson's ratio, with exact derivatives.

A body of known shape in a material of Young's modulus E, density ρ and Poisson's ratio ν has the frequencies

    f_k = s ω̂_k(ν),   s = sqrt(E/ρ) / (2π · metres per mesh unit).

The basis of the body, its corrections included, makes ω̂² the eigenvalues of ``λ(ν) A_λ + μ(ν) A_μ`` with a few hundred
unknowns. For a normalised eigenvector c, ``dω̂²/dν = cᵀ (λ' A_λ + μ' A_μ) c`` (Hellmann and Feynman).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.interpolate import CubicHermiteSpline

from vibraverse.physics.columns import lowest_pairs
from vibraverse.physics.materials import lame
from vibraverse.physics.modes import reduced_solve
from vibraverse.physics.reduced import ModalBasis

#: Largest steps in ν between the lines of a table, and between hypotheses about ν.
_NODE_STEP, _GRID_STEP = 0.03, 0.01

#: An estimated error may be small by accident, so this share of the median is added to each.
_COMMON_ERROR = 0.5


@dataclass(frozen=True)
class Lines:
    """``log ω̂`` (m,), ascending, its derivatives by q parameters (m, q), and its error by the elements (m,).

    The parameters are ν and, for a body whose wall is sought, the wall's.
    """

    log_omega: np.ndarray
    slopes: np.ndarray
    error: np.ndarray


class Resonances:
    """The lines of one body, for E = ρ = 1 and lengths in mesh units."""

    def __init__(self, basis: ModalBasis):
        rank, added = basis.correction_mass.shape
        mass = np.eye(rank + added)
        mass[:rank, rank:], mass[rank:, :rank] = basis.correction_mass, basis.correction_mass.T
        root = scipy.linalg.cholesky(mass, lower=True)
        self._stiffness = tuple(
            _congruent(root, own, columns)
            for own, columns in (
                (basis.a_lambda, basis.correction_lambda),
                (basis.a_mu, basis.correction_mu),
            )
        )
        self.modes = len(basis.residuals)
        self.bounds = np.array(basis.poisson_range, dtype=float)[None]
        estimated = reduced_solve(basis, self.bounds.mean(), self.modes).discretisation_error
        self._error = np.hypot(estimated, _COMMON_ERROR * np.median(estimated))

    def at(self, parameters: np.ndarray) -> Lines:
        """Return the lines at a Poisson's ratio, ``parameters`` (1,)."""
        (poisson,) = parameters
        lam, mu = lame(1.0, poisson)
        of_lambda, of_mu = self._stiffness
        values, vectors = lowest_pairs(lam * of_lambda + mu * of_mu, self.modes)
        grown = (1 + 2 * poisson**2) / ((1 + poisson) * (1 - 2 * poisson)) ** 2, -0.5 / (1 + poisson) ** 2
        slopes = sum(
            factor * np.vecdot(vectors, matrix @ vectors, axis=0)
            for factor, matrix in zip(grown, self._stiffness, strict=True)
        )
        return Lines(0.5 * np.log(values), 0.5 * (slopes / values)[:, None], self._error)

    def table(self) -> Table:
        """Return a table of the lines over the range of ν."""
        low, high = self.bounds[0]
        nodes = np.linspace(low, high, 1 + max(1, int(np.ceil((high - low) / _NODE_STEP - 1e-9))))
        solved = [self.at(np.array([one])) for one in nodes]
        return Table(
            nodes,
            np.array([one.log_omega for one in solved]),
            np.array([one.slopes[:, 0] for one in solved]),
            self._error,
        )


class Table:
    """Lines at some ν (n,), and between them by cubics with the right values and slopes at both ends.

    That takes microseconds. Where two lines cross between the nodes, the sorted ones have a kink that a cubic rounds
    off, so an answer is refined with the lines themselves.
    """

    def __init__(self, nodes: np.ndarray, log_omega: np.ndarray, slopes: np.ndarray, error: np.ndarray):
        self.bounds = nodes[None, [0, -1]]
        self._cubic = CubicHermiteSpline(nodes, log_omega, slopes)
        self._slope = self._cubic.derivative()
        self._error = error

    def at(self, parameters: np.ndarray) -> Lines:
        """Return the lines at a Poisson's ratio, ``parameters`` (1,)."""
        (poisson,) = parameters
        return Lines(self._cubic(poisson), self._slope(poisson)[:, None], self._error)

    def grid(self, bounds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return hypotheses about ν (r, 1) within bounds (1, 2), and ``log ω̂`` (r, m) there."""
        low, high = bounds[0]
        fine = np.linspace(low, high, 1 + int(np.ceil((high - low) / _GRID_STEP)))
        return fine[:, None], self._cubic(fine)


def _congruent(root: np.ndarray, own: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return a stiffness (n, n) in a basis that is orthonormal in the mass with the Cholesky factor ``root``.

    ``own`` (r, r) belongs to the basis, ``columns`` (n, n - r) to the corrections.
    """
    rank = len(own)
    full = np.block([[own, columns[:rank]], [columns[:rank].T, columns[rank:]]])
    half = scipy.linalg.solve_triangular(root, full, lower=True)
    whole = scipy.linalg.solve_triangular(root, half.T, lower=True)
    return 0.5 * (whole + whole.T)
