"""Sparse factorisations of symmetric matrices, behind one small interface.

``PARDISO`` (MKL, through pypardiso) is the fast one; ``SuperLU`` (in SciPy) always works. Both solve for many
right-hand sides at once, and both count the negative eigenvalues of an indefinite matrix (Sylvester's law of inertia).
PARDISO's LDLᵀ pivots for stability; SuperLU must not, to stay symmetric, so that its count needs a test of accuracy.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from vibraverse.refusal import Refused

_PARDISO_OUT_OF_MEMORY = -2


class SuperLU:
    """LU factorisation by SciPy's SuperLU with an ordering for symmetric patterns."""

    name = "superlu"

    def __init__(self, matrix: sp.csr_matrix):
        self.update(matrix)

    def update(self, matrix: sp.csr_matrix) -> None:
        """Factorise another matrix."""
        from scipy.sparse.linalg import splu

        try:
            self._lu = splu(
                matrix.tocsc(),
                permc_spec="MMD_AT_PLUS_A",
                diag_pivot_thresh=0.0,
                options={"SymmetricMode": True},
            )
        except RuntimeError as error:
            raise Refused("solve_failed", f"SuperLU could not factorise the matrix: {error}.") from None

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Return ``x`` with ``A x = b`` for b of shape (n,) or (n, k)."""
        return self._lu.solve(np.asarray(b))

    def inverse_root(self, noise: np.ndarray) -> np.ndarray:
        """Return ``R noise`` for noise (n, k), where ``R Rᵀ = A⁻¹`` and A is positive definite."""
        # A = Pᵀ L D Lᵀ P, so Pᵀ L sqrt(D) is a root of A.
        root = self._lu.L @ (np.sqrt(self._diagonal())[:, None] * noise)
        return self._lu.solve(root[self._lu.perm_r])

    @property
    def negative_pivots(self) -> int:
        """The number of negative eigenvalues of a symmetric matrix (Sylvester's law of inertia)."""
        return int((self._diagonal() < 0).sum())

    def _diagonal(self) -> np.ndarray:
        """Return the diagonal of D in ``A = Pᵀ L D Lᵀ P``: without pivoting U is ``D Lᵀ``."""
        if not np.array_equal(self._lu.perm_r, self._lu.perm_c):
            raise Refused("solve_failed", "SuperLU had to pivot, which leaves no symmetric factors.")
        return self._lu.U.diagonal()

    def free(self) -> None:
        """Give the memory back."""
        self._lu = None


class Pardiso:
    """Cholesky (``definite``) or LDLᵀ factorisation by MKL's PARDISO.

    ``negative_pivots`` is the number of negative eigenvalues of an indefinite matrix.
    """

    name = "pardiso"

    def __init__(self, matrix: sp.csr_matrix, definite: bool = True):
        self._solver = _pardiso_solver(2 if definite else -2)
        # All parameters are set by hand: nested-dissection ordering, scaling and matching off for a
        # positive definite matrix, no iterative refinement (the eigensolver measures residuals itself).
        iparm = self._solver.iparm
        iparm[:] = 0
        iparm[0], iparm[1], iparm[9], iparm[20] = 1, 2, 8, 1
        if not definite:
            iparm[10] = iparm[12] = 1
        self._phase(12, matrix)

    def update(self, matrix: sp.csr_matrix) -> None:
        """Factorise another matrix with the same sparsity pattern, reusing the ordering."""
        self._phase(22, matrix)

    def _phase(self, phase: int, matrix: sp.csr_matrix) -> None:
        from pypardiso.pardiso_wrapper import PyPardisoError

        self._upper = sp.triu(matrix, format="csr")
        self._upper.sort_indices()
        self._solver.set_phase(phase)
        try:
            self._solver._call_pardiso(self._upper, np.zeros((matrix.shape[0], 1), order="F"))
        except PyPardisoError as error:
            self.free()
            if error.value == _PARDISO_OUT_OF_MEMORY:
                raise MemoryError from None
            raise Refused("solve_failed", f"PARDISO could not factorise the matrix: {error}") from None
        self.negative_pivots = int(self._solver.iparm[22])
        self._solver.set_phase(33)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Return ``x`` with ``A x = b`` for b of shape (n,) or (n, k), columns contiguous."""
        return np.asfortranarray(self._solver._call_pardiso(self._upper, np.asfortranarray(b, dtype=float)))

    def inverse_root(self, noise: np.ndarray) -> np.ndarray:
        """Return ``R noise`` for noise (n, k), where ``R Rᵀ = A⁻¹`` and A is positive definite: half a solve."""
        self._solver.set_phase(333)
        try:
            return self.solve(noise)
        finally:
            self._solver.set_phase(33)

    def free(self) -> None:
        """Give PARDISO's memory back; Python cannot see it."""
        if self._solver is not None:
            self._solver.free_memory(everything=True)
            self._solver = None

    def __del__(self):
        if getattr(self, "_solver", None) is not None and not sys.is_finalizing():
            self.free()


def available(name: str = "auto") -> str:
    """Return the factorisation to use: ``auto`` is PARDISO where it loads, else SuperLU."""
    if name != "auto":
        return name
    try:
        _pardiso_solver(2)
    except (ImportError, OSError):
        return "superlu"
    return "pardiso"


def _pardiso_solver(matrix_type: int):
    """Return pypardiso's solver, told where MKL lies: by itself it searches the whole environment for it."""
    if "PYPARDISO_MKL_RT" not in os.environ:
        libraries = sorted(Path(sys.prefix, "lib").glob("libmkl_rt.so*"))
        if libraries:
            os.environ["PYPARDISO_MKL_RT"] = str(libraries[0])
    from pypardiso import PyPardisoSolver

    return PyPardisoSolver(mtype=matrix_type)


def factorise(matrix: sp.csr_matrix, name: str = "auto", definite: bool = True):
    """Factorise a symmetric sparse matrix with the named or the best available method.

    Raises :class:`Refused` with reason ``solve_failed`` when the matrix cannot be factorised, ``MemoryError`` where
    there is too little memory for its factors.
    """
    if available(name) == "pardiso":
        return Pardiso(matrix, definite)
    return SuperLU(matrix)
