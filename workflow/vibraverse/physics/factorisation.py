"""Sparse factorisations of symmetric matrices, behind one small interface.

``PARDISO`` (MKL, through pypardiso) is the fast one; ``SuperLU`` (in SciPy) always works. Both solve for many
right-hand sides at once, and both count the negative eigenvalues of an indefinite matrix (Sylvester's law of inertia).
PARDISO's LDLᵀ pivots inside blocks, SuperLU must not pivot at all to stay symmetric, so that a count needs a test of
accuracy.
"""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from vibraverse.contract.errors import Refused
from vibraverse.contract.limits import out_of_memory

#: PARDISO's phases and errors.
_ANALYSE_AND_FACTORISE, _FACTORISE, _SOLVE, _SOLVE_BACKWARD = 12, 22, 33, 333
_PARDISO_OUT_OF_MEMORY = -2
_OTHERWISE = "Choose another basis.factorisation, or change tets.target_elements."
_INTEGERS = ctypes.POINTER(ctypes.c_int32)


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
            if out_of_memory(error):
                raise MemoryError from None
            raise Refused(
                "solve_failed", f"SuperLU could not factorise the matrix: {error}.", _OTHERWISE
            ) from None

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
            raise Refused(
                "solve_failed", "SuperLU had to pivot, which leaves no symmetric factors.", _OTHERWISE
            )
        return self._lu.U.diagonal()

    def free(self) -> None:
        """Give the memory back."""
        self._lu = None


class Pardiso:
    """Cholesky (``definite``) or LDLᵀ factorisation by MKL's PARDISO.

    ``negative_pivots`` is the number of negative eigenvalues of an indefinite matrix.
    """

    name = "pardiso"

    def __init__(
        self,
        matrix: sp.csr_matrix,
        definite: bool = True,
        like: Pardiso | None = None,
        matched: bool = False,
    ):
        self._solver = _pardiso_solver(2 if definite else -2)
        # All parameters are set by hand: nested-dissection ordering, which is handed out or, where there is another
        # factorisation of the same pattern, taken in; scaling and matching only where asked for, since they take longer
        # than the factors; no iterative refinement (the eigensolver measures residuals itself).
        iparm = self._solver.iparm
        iparm[:] = 0
        iparm[0], iparm[1], iparm[9], iparm[20] = 1, 2, 8, 1
        iparm[4] = 2 if like is None else 1
        iparm[10] = iparm[12] = int(matched)
        self._solver.perm = np.zeros(matrix.shape[0], dtype=np.int32) if like is None else like._solver.perm
        self._phase(_ANALYSE_AND_FACTORISE, matrix)

    def update(self, matrix: sp.csr_matrix) -> None:
        """Factorise another matrix with the same sparsity pattern, reusing the ordering."""
        self._phase(_FACTORISE, matrix)

    def _phase(self, phase: int, matrix: sp.csr_matrix) -> None:
        upper = sp.triu(matrix, format="csr")
        upper.sort_indices()
        # PARDISO wants them for solves too, and counts from one.
        self._matrix = upper.data, upper.indptr.astype(np.int32) + 1, upper.indices.astype(np.int32) + 1
        try:
            self._call(phase, np.zeros((matrix.shape[0], 1), order="F"))
        except (MemoryError, Refused):
            self.free()
            raise
        self.negative_pivots = int(self._solver.iparm[22])

    def _call(self, phase: int, b: np.ndarray) -> np.ndarray:
        """Run a phase for right-hand sides (n, k), columns contiguous, and return what it makes of them.

        pypardiso's own call would turn them over, and back, and build the indices anew every time.
        """
        solver, error, out = self._solver, ctypes.c_int32(0), np.zeros_like(b, order="F")
        values, rows, columns = self._matrix
        solver._mkl_pardiso(
            solver.pt.ctypes.data_as(ctypes.POINTER(ctypes.c_int64)),
            *(_integer(value) for value in (1, 1, solver.mtype, phase, len(b))),
            values.ctypes.data,
            *(array.ctypes.data_as(_INTEGERS) for array in (rows, columns, solver.perm)),
            _integer(b.shape[1]),
            solver.iparm.ctypes.data_as(_INTEGERS),
            _integer(0),
            b.ctypes.data,
            out.ctypes.data,
            ctypes.byref(error),
        )
        if error.value == _PARDISO_OUT_OF_MEMORY:
            raise MemoryError
        if error.value:
            raise Refused(
                "solve_failed",
                f"PARDISO could not factorise the matrix or solve with it (its error {error.value}).",
                _OTHERWISE,
            )
        return out

    def solve(self, b: np.ndarray, phase: int = _SOLVE) -> np.ndarray:
        """Return ``x`` with ``A x = b`` for b of shape (n,) or (n, k), columns contiguous."""
        columns = b[:, None] if b.ndim == 1 else b
        return self._call(phase, np.asfortranarray(columns, dtype=float)).reshape(b.shape, order="F")

    def inverse_root(self, noise: np.ndarray) -> np.ndarray:
        """Return ``R noise`` for noise (n, k), where ``R Rᵀ = A⁻¹`` and A is positive definite: half a solve."""
        return self.solve(noise, _SOLVE_BACKWARD)

    def free(self) -> None:
        """Give PARDISO's memory back; Python cannot see it."""
        if self._solver is not None:
            self._solver.free_memory(everything=True)
            self._solver = None

    def __del__(self):
        if getattr(self, "_solver", None) is not None and not sys.is_finalizing():
            self.free()


def _integer(value: int):
    """Return a pointer to an integer, as Fortran takes it."""
    return ctypes.byref(ctypes.c_int32(value))


def available(name: str = "auto") -> str:
    """Return the factorisation to use: ``auto`` is PARDISO where it loads, else SuperLU."""
    if name != "auto":
        return name
    try:
        _pardiso_solver(2)
    except (ImportError, OSError):
        return "superlu"
    return "pardiso"


def load(name: str = "auto") -> None:
    """Let the solvers load and set aside what they do with their first matrix.

    Where memory is limited and runs out at that moment, MKL ends the process, and OpenBLAS asks again for ever.
    """
    import scipy.linalg

    small = np.eye(64)
    for module in (np.linalg, scipy.linalg):
        module.eigh(small @ small)
    factor = factorise(sp.csr_matrix(small), name)
    factor.solve(small)
    factor.free()


def _pardiso_solver(matrix_type: int):
    """Return pypardiso's solver, told where MKL lies: by itself it searches the whole environment for it."""
    if "PYPARDISO_MKL_RT" not in os.environ:
        libraries = sorted(Path(sys.prefix, "lib").glob("libmkl_rt.so*"))
        if libraries:
            os.environ["PYPARDISO_MKL_RT"] = str(libraries[0])
    from pypardiso import PyPardisoSolver

    return PyPardisoSolver(mtype=matrix_type)


def factorise(
    matrix: sp.csr_matrix, name: str = "auto", definite: bool = True, like=None, matched: bool = False
):
    """Factorise a symmetric sparse matrix with the named or the best available method.

    The unknowns are ordered as in the factorisation ``like`` of a matrix with the same pattern, where that is of use.
    With ``matched`` rows are scaled and matched before, which takes time and keeps digits of an indefinite matrix.
    Raises :class:`Refused` with reason ``solve_failed`` when the matrix cannot be factorised, ``MemoryError`` where
    there is too little memory for its factors.
    """
    if available(name) == "pardiso":
        return Pardiso(matrix, definite, like if isinstance(like, Pardiso) else None, matched)
    return SuperLU(matrix)
