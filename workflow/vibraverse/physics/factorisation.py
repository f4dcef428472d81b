"""Sparse factorisations of symmetric matrices, with a common interface.

PARDISO (MKL, through pypardiso) is fast; SuperLU (in SciPy) is always available. Both solve for many right-hand sides
at once and count the negative eigenvalues of an indefinite matrix (Sylvester's law of inertia). PARDISO's LDLᵀ pivots
only inside blocks, and SuperLU must not pivot at all to stay symmetric. So a count needs a test of accuracy.
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

#: PARDISO's codes of phases and errors.
_ANALYSE_AND_FACTORISE, _FACTORISE, _SOLVE, _SOLVE_BACKWARD = 12, 22, 33, 333
_PARDISO_OUT_OF_MEMORY = -2
_ADVICE = "Choose another basis.factorisation, or change tets.target_elements."
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
                "solve_failed", f"SuperLU could not factorise the matrix: {error}.", _ADVICE
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
            raise Refused("solve_failed", "SuperLU had to pivot, which leaves no symmetric factors.", _ADVICE)
        return self._lu.U.diagonal()

    def free(self) -> None:
        """Free the memory."""
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
        # Explicit parameters: a nested-dissection ordering, returned for reuse or taken from a factorisation of the
        # same pattern; scaling and matching only on demand, because they take longer than the factorisation itself; no
        # iterative refinement, because the eigensolver measures residuals.
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
        # PARDISO needs these for solves too, and its indices start at one.
        self._matrix = upper.data, upper.indptr.astype(np.int32) + 1, upper.indices.astype(np.int32) + 1
        try:
            self._call(phase, np.zeros((matrix.shape[0], 1), order="F"))
        except (MemoryError, Refused):
            self.free()
            raise
        self.negative_pivots = int(self._solver.iparm[22])

    def _call(self, phase: int, b: np.ndarray) -> np.ndarray:
        """Run a phase for right-hand sides (n, k) with contiguous columns, and return its result (n, k).

        pypardiso's own call would transpose them twice and rebuild the indices every time.
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
                _ADVICE,
            )
        return out

    def solve(self, b: np.ndarray, phase: int = _SOLVE) -> np.ndarray:
        """Return ``x`` with ``A x = b`` for b of shape (n,) or (n, k), columns contiguous."""
        columns = b[:, None] if b.ndim == 1 else b
        return self._call(phase, np.asfortranarray(columns, dtype=float)).reshape(b.shape, order="F")

    def inverse_root(self, noise: np.ndarray) -> np.ndarray:
        """Return ``R noise`` for noise (n, k), where ``R Rᵀ = A⁻¹`` and A is positive definite; costs half a solve."""
        return self.solve(noise, _SOLVE_BACKWARD)

    def free(self) -> None:
        """Free PARDISO's memory, which Python's garbage collector does not see."""
        if self._solver is not None:
            self._solver.free_memory(everything=True)
            self._solver = None

    def __del__(self):
        if getattr(self, "_solver", None) is not None and not sys.is_finalizing():
            self.free()


def _integer(value: int):
    """Return a pointer to an integer, as Fortran expects it."""
    return ctypes.byref(ctypes.c_int32(value))


def available(name: str = "auto") -> str:
    """Return the name of the factorisation to use: ``auto`` means PARDISO if it loads, else SuperLU."""
    if name != "auto":
        return name
    try:
        _pardiso_solver(2)
    except (ImportError, OSError):
        return "superlu"
    return "pardiso"


def load(name: str = "auto") -> None:
    """Load the solvers and let them allocate their workspace, by a small first problem.

    If memory is limited and runs out at that moment, MKL ends the process and OpenBLAS retries for ever.
    """
    import scipy.linalg

    small = np.eye(64)
    for module in (np.linalg, scipy.linalg):
        module.eigh(small @ small)
    factor = factorise(sp.csr_matrix(small), name)
    factor.solve(small)
    factor.free()


def _pardiso_solver(matrix_type: int):
    """Return pypardiso's solver; naming MKL's library spares its search through the whole environment."""
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

    PARDISO reuses the ordering of ``like``, a factorisation of a matrix with the same pattern. ``matched`` scales and
    matches rows first, which takes time and preserves digits of an indefinite matrix. Raises :class:`Refused` with
    reason ``solve_failed`` if the matrix cannot be factorised, ``MemoryError`` if its factors do not fit into memory.
    """
    if available(name) == "pardiso":
        return Pardiso(matrix, definite, like if isinstance(like, Pardiso) else None, matched)
    return SuperLU(matrix)
