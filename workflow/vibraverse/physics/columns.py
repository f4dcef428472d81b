"""Blocks of column vectors: storage, M-orthonormalisation, Rayleigh–Ritz, residuals and signs."""

from __future__ import annotations

import numpy as np
import scipy.linalg
import scipy.sparse as sp

#: A vector is orthogonalised twice if the first pass leaves less than this share of it, because of rounding.
_CANCELLATION = 1e-4
#: A Gram matrix whose smallest eigenvalue exceeds this share of the largest needs no second pass.
_WELL_CONDITIONED = 1e-3


class Columns:
    """A growing (n, size) array with contiguous columns; :attr:`all` is a view of the columns so far."""

    def __init__(self, rows: int, capacity: int):
        self._array = np.empty((rows, capacity), order="F")
        self.size = 0

    @property
    def all(self) -> np.ndarray:
        """The columns so far, (n, size)."""
        return self._array[:, : self.size]

    def append(self, block: np.ndarray) -> None:
        """Append the columns of ``block`` (n, k)."""
        needed = self.size + block.shape[1]
        if needed > self._array.shape[1]:
            grown = np.empty((self._array.shape[0], max(needed, self._array.shape[1] * 3 // 2)), order="F")
            grown[:, : self.size] = self.all
            self._array = grown
        self._array[:, self.size : needed] = block
        self.size = needed


def combine(space: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return ``space @ coefficients`` with contiguous columns: twice as fast as NumPy's order if space has them too."""
    return (coefficients.T @ space.T).T


def product(matrix: sp.csr_matrix, block: np.ndarray) -> np.ndarray:
    """Return ``matrix @ block`` with contiguous rows; SciPy is four times slower at reordering a block itself."""
    return matrix @ np.ascontiguousarray(block)


def project(space: np.ndarray, matrix: sp.csr_matrix) -> np.ndarray:
    """Return ``spaceᵀ matrix space``, exactly symmetric."""
    projected = space.T @ product(matrix, space)
    return 0.5 * (projected + projected.T)


def project_out(block: np.ndarray, space: np.ndarray, weighted: np.ndarray) -> np.ndarray:
    """Subtract from ``block`` (n, k), in place, its M-orthogonal projection onto an M-orthonormal ``space`` (n, m).

    ``weighted`` is ``M space``. Returns the coefficients (m, k) of the projection.
    """
    before = np.linalg.norm(block, axis=0)
    coefficients = weighted.T @ block
    block -= combine(space, coefficients)
    if (np.linalg.norm(block, axis=0) < _CANCELLATION * before).any():
        again = weighted.T @ block
        block -= combine(space, again)
        coefficients += again
    return coefficients


def orthonormalising(gram: np.ndarray, rounding: float) -> tuple[np.ndarray, float]:
    """Return ``turn`` (m, k) with ``turnᵀ gram turn = I`` for a Gram matrix (m, m), and its least eigenvalue.

    Columns are scaled to unit length first. Directions whose eigenvalue is below the share ``rounding`` of the largest
    one are left out. The least eigenvalue is relative to the largest.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    weights, directions = scipy.linalg.eigh(gram * scale[:, None] * scale)
    kept = weights > rounding * weights[-1]
    turn = scale[:, None] * directions[:, kept] / np.sqrt(weights[kept])
    return turn, float(weights[0] / weights[-1])


def orthonormalise(space: np.ndarray, mass: sp.csr_matrix):
    """Return an M-orthonormal basis Q of the columns' span, ``M Q`` and ``M space``.

    Directions that are rounding errors are left out. A second pass removes the rounding errors of the first, if that
    lost more than a few digits.
    """
    weighted_space = weighted = product(mass, space)
    for limit in (1e-14, 1e-3):
        turn, condition = orthonormalising(space.T @ weighted, limit)
        space, weighted = combine(space, turn), combine(weighted, turn)
        if condition > _WELL_CONDITIONED:
            break
    return space, weighted, weighted_space


def rayleigh_ritz(space: np.ndarray, stiffness: sp.csr_matrix, mass: sp.csr_matrix):
    """Return the Ritz pairs of ``K u = ω² M u`` in the span of ``space`` (n, m), with their residuals.

    ω² (m,) ascend, ``u`` (n, m) are M-orthonormal, and the residuals (m,) are ``‖K u - ω² M u‖ / ‖ω² M u‖``.
    """
    stiff, weighted = product(stiffness, space), product(mass, space)
    energy, gram = space.T @ stiff, space.T @ weighted
    values, turn = scipy.linalg.eigh(0.5 * (energy + energy.T), 0.5 * (gram + gram.T))
    # Each of these arrays is as large as the space, so each is freed as early as possible.
    force = combine(stiff, turn)
    del stiff
    inertia = combine(weighted, turn)
    del weighted
    found = _relative(force, inertia, values)
    del force, inertia
    return values, combine(space, turn), found


def residuals(stiffness, mass, values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return ``‖K u - ω² M u‖ / ‖ω² M u‖`` of every pair (Euclidean norms)."""
    return _relative(product(stiffness, vectors), product(mass, vectors), values)


def _relative(force: np.ndarray, inertia: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return ``‖K u - ω² M u‖ / ‖ω² M u‖`` from ``K u`` and ``M u``, which are overwritten."""
    inertia *= values
    force -= inertia
    return np.linalg.norm(force, axis=0) / np.linalg.norm(inertia, axis=0)


def fix_signs(vectors: np.ndarray) -> np.ndarray:
    """Return the columns with signs that make their largest entries positive."""
    return vectors * signs(vectors)


def signs(vectors: np.ndarray) -> np.ndarray:
    """Return the sign of the largest entry of every column, (m,): 1 or -1."""
    return np.where(vectors.max(axis=0) < -vectors.min(axis=0), -1.0, 1.0)


def lowest_pairs(
    stiffness: np.ndarray, count: int, mass: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest eigenvalues (count,) and eigenvectors (n, count) of dense symmetric matrices (n, n).

    Divide and conquer finds all pairs. For some hundred rows it takes less time than other drivers for the wanted ones.
    """
    values, vectors = scipy.linalg.eigh(stiffness, mass, driver="evd" if mass is None else "gvd")
    return values[:count], vectors[:, :count]
