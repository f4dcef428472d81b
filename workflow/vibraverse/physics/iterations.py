"""Iterative methods of :mod:`vibraverse.physics.eigensolver` for the lowest eigenpairs of ``K u = ω² M u``.

Each takes a :class:`Pencil` and returns :class:`Found`: at least the wanted pairs, rigid motions included, up to a gap
in the spectrum, and the eigenvalue after the gap. A method may miss pairs without noticing, so the caller counts them.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import said
from vibraverse.physics.columns import Columns, combine, orthonormalise, product, project_out, rayleigh_ritz
from vibraverse.physics.elasticity import rigid_modes

RIGID = 6
#: An eigenvalue below this share of the largest one is zero within rounding.
_ZERO_TOLERANCE = 1e-8
#: Smallest block of block Lanczos, and its size as a share of the wanted pairs if these are many.
_MIN_BLOCK, _BLOCK_SHARE = 10, 1 / 16
#: Pairs computed beyond the wanted ones to find a gap in the spectrum.
_EXTRA_PAIRS = 10
#: Smallest relative gap between neighbouring eigenvalues that separates multiplets; meshes split these by far less.
_MIN_GAP = 1e-3
#: Most iterations of LOBPCG.
_MAX_ITERATIONS = 60


@dataclass(frozen=True)
class Pencil:
    """The eigenproblem of a method: K and M (n, n), and the factorised ``K - σM`` for a negative shift σ.

    ``nodes`` (n/3, 3) are the coordinates of the nodes.
    """

    stiffness: sp.csr_matrix
    mass: sp.csr_matrix
    shift: float
    nodes: np.ndarray
    factor: object


@dataclass(frozen=True)
class Found:
    """Eigenpairs below a gap: ``values`` (k,), ``vectors`` (n, k) and ``residuals`` (k,).

    ``following`` is the value after the gap. ``solves`` counts right-hand sides, or applications of the
    preconditioner.
    """

    values: np.ndarray
    vectors: np.ndarray
    residuals: np.ndarray
    following: float
    solves: int

    @property
    def zeros(self) -> np.ndarray:
        """Which values (k,) are zero within rounding: those of rigid motions."""
        return np.abs(self.values) < _ZERO_TOLERANCE * self.values[-1]

    @property
    def worst(self) -> float:
        """Largest residual of the elastic pairs."""
        return float(self.residuals[~self.zeros].max())


def block_lanczos(
    pencil: Pencil, wanted: int, tolerance: float, rng: np.random.Generator, extra: int = 0
) -> Found:
    """Run block Lanczos on ``(K - σM)⁻¹ M`` with full reorthogonalisation in the M inner product.

    The space V grows by a block per pass, and ``T = Vᵀ M (K - σM)⁻¹ M V`` gives Ritz values ``θ = 1/(λ - σ)``. The
    residual f of a Ritz vector ``u`` is its last block row times the block F that links V to the next block. There are
    no restarts, so memory holds two arrays of n by about four times the wanted modes.

    The result is ``(K - σM)⁻¹ M u / θ = u + f/θ``, a step of inverse iteration that costs no solve (Ericsson and Ruhe,
    Math. Comp. 35, 1251, 1980). Its residual for ``K u = λ M u`` is ``-M f / θ²``, without the rough displacements in
    ``u`` that K would amplify. ``extra`` widens the blocks.
    """
    solve, mass, n = pencil.factor.solve, pencil.mass, pencil.mass.shape[0]
    block = max(_MIN_BLOCK, int(wanted * _BLOCK_SHARE)) + extra
    limit, goal = min(n - block, 16 * wanted), tolerance
    space, weighted = Columns(n, 4 * wanted), Columns(n, 4 * wanted)
    projected = np.zeros((0, 0))
    fresh, weighted_fresh, _ = orthonormalise(solve(mass @ rng.standard_normal((n, block))), mass)
    while True:
        old, width = space.size, fresh.shape[1]
        space.append(fresh)
        weighted.append(weighted_fresh)
        image = solve(weighted_fresh)
        column = project_out(image, space.all, weighted.all)
        projected = np.pad(projected, (0, width))
        projected[:, old:] = column
        projected[old:, :] = column.T
        fresh, weighted_fresh, weighted_image = orthonormalise(image, mass)
        size, seen = space.size, min(wanted + _EXTRA_PAIRS, n)
        if size < seen:
            continue
        theta, mixing = scipy.linalg.eigh(projected, subset_by_index=(size - seen, size - 1))
        theta, mixing = theta[::-1], mixing[:, ::-1]
        values = pencil.shift + 1.0 / theta
        link = (fresh.T @ weighted_image) @ mixing[old:] / theta
        error = np.linalg.norm(link, axis=0)
        kept, distance = gap(values, wanted)
        # The next value must be accurate enough to lie beyond the gap.
        if error[:kept].max() <= goal and error[kept] <= 0.25 * distance:
            weighted = None  # frees memory for the next steps
            vectors = combine(space.all, mixing[:, :kept])
            vectors += combine(fresh, link[:, :kept])
            ritz, more = _smoothed(pencil, vectors, tolerance)
            found = Found(*ritz, float(values[kept]), block + size + more)
            # Rounding is the limit once more vectors no longer help.
            if found.worst <= tolerance or goal < 0.05 * tolerance:
                return found
            goal *= 0.1
            weighted = Columns(n, 4 * wanted)
            weighted.append(product(mass, space.all))
        if size + width > limit:
            raise Refused(
                "solve_failed",
                f"Block Lanczos only reached a residual of {error[:kept].max():.1e} with {size} vectors.",
                "Raise basis.tolerance, or lower basis.modes.",
            )


def arpack(pencil: Pencil, wanted: int, tolerance: float, rng: np.random.Generator, extra: int = 0) -> Found:
    """Run SciPy's implicitly restarted Lanczos on the same operator, vector by vector; ``extra`` adds vectors."""
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

    n, solves = pencil.mass.shape[0], 0
    pairs = min(wanted + _EXTRA_PAIRS, n - 2)

    def solve(b):
        nonlocal solves
        solves += 1
        return pencil.factor.solve(b)

    try:
        values, vectors = eigsh(
            pencil.stiffness,
            k=pairs,
            M=pencil.mass,
            sigma=pencil.shift,
            OPinv=LinearOperator((n, n), matvec=solve, dtype=float),
            v0=rng.standard_normal(n),
            tol=tolerance,
            ncv=min(n - 1, int(2.2 * pairs) + 10 * extra),
        )
    except ArpackNoConvergence as error:
        raise Refused(
            "solve_failed",
            f"ARPACK did not converge: {said(error)}.",
            "Raise basis.tolerance, or choose another basis.method.",
        ) from None
    return _until_gap(pencil, vectors[:, np.argsort(values)], wanted, tolerance, solves)


def lobpcg(pencil: Pencil, wanted: int, tolerance: float, rng: np.random.Generator, extra: int = 0) -> Found:
    """Run SciPy's LOBPCG (Knyazev, SIAM J. Sci. Comput. 23, 517, 2001), preconditioned by the factorised ``K - σM``.

    It is popular because it does not need a factorisation, but with an incomplete one it fails on thin bodies. The
    known rigid motions are its constraints. ``extra`` adds vectors to the block.
    """
    from scipy.sparse.linalg import LinearOperator
    from scipy.sparse.linalg import lobpcg as scipy_lobpcg

    n, solves = pencil.mass.shape[0], 0

    def precondition(b):
        nonlocal solves
        solves += b.size // n
        return pencil.factor.solve(b)

    rigid, weighted_rigid, _ = orthonormalise(rigid_modes(pencil.nodes), pencil.mass)
    pairs = min(wanted - RIGID + _EXTRA_PAIRS, n - RIGID - 2) + extra
    # LOBPCG bounds ‖K u - ω² M u‖. -σ is about half the first elastic ω²; rigid motions give the scale of ‖M u‖.
    size = -pencil.shift * np.linalg.norm(weighted_rigid, axis=0).min()
    with warnings.catch_warnings():
        # It warns if it does not converge; the caller checks the residuals.
        warnings.simplefilter("ignore")
        _, vectors = scipy_lobpcg(
            pencil.stiffness,
            rng.standard_normal((n, pairs)),
            B=pencil.mass,
            M=LinearOperator((n, n), matvec=precondition, matmat=precondition, dtype=float),
            Y=rigid,
            largest=False,
            tol=tolerance * size,
            maxiter=_MAX_ITERATIONS,
        )
    return _until_gap(pencil, np.hstack([rigid, vectors]), wanted, tolerance, solves)


def gap(values: np.ndarray, wanted: int) -> tuple[int, float]:
    """Return the number of ascending ``values`` up to a gap, and the relative width of that gap.

    The number is ``wanted`` or a few more: up to the first gap that is wide enough, else up to the widest.
    """
    distances = np.diff(values[wanted - 1 :]) / values[wanted - 1 : -1]
    wide = distances > _MIN_GAP
    first = int(np.argmax(wide if wide.any() else distances))
    return wanted + first, float(distances[first])


def _smoothed(pencil: Pencil, vectors: np.ndarray, tolerance: float):
    """Return the Ritz pairs of ``vectors`` with their residuals, and how many vectors needed another solve.

    Orthogonalisation amplifies rough rounding errors. In thin bodies K turns them into residuals of the lowest modes,
    so vectors with too large a residual take a step of inverse iteration.
    """
    ritz = rayleigh_ritz(vectors, pencil.stiffness, pencil.mass)
    values, vectors, residuals = ritz
    rough = (residuals > tolerance) & (np.abs(values) > _ZERO_TOLERANCE * values[-1])
    if rough.any():
        vectors[:, rough] = pencil.factor.solve(pencil.mass @ vectors[:, rough])
        ritz = rayleigh_ritz(vectors, pencil.stiffness, pencil.mass)
    return ritz, int(rough.sum())


def _until_gap(pencil: Pencil, vectors: np.ndarray, wanted: int, tolerance: float, solves: int) -> Found:
    """Return the Ritz pairs of ``vectors``, more than wanted, up to a gap."""
    (values, vectors, residuals), more = _smoothed(pencil, vectors, tolerance)
    kept, _ = gap(values, wanted)
    return Found(values[:kept], vectors[:, :kept], residuals[:kept], float(values[kept]), solves + more)
