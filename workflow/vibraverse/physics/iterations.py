"""Iterations for the lowest eigenpairs of ``K u = ω² M u``: the methods behind :mod:`vibraverse.physics.eigensolver`.

Each takes a :class:`Pencil` and returns :class:`Found`: at least the pairs wanted, rigid motions included, up to a
place where the spectrum has a gap, and where the next one lies. What a method missed it cannot know; that is counted
by who calls.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import said
from vibraverse.physics.columns import Columns, clear, combine, orthonormalise, product, rayleigh_ritz
from vibraverse.physics.elasticity import rigid_modes

RIGID = 6
#: An eigenvalue below this share of the largest one is zero but for rounding.
_ZERO = 1e-8
#: Vectors per pass of block Lanczos, or this share of the pairs wanted where these are many.
_BLOCK, _BLOCK_SHARE = 10, 1 / 16
#: Pairs looked at beyond those wanted, to find a gap in the spectrum.
_AHEAD = 10
#: A relative distance of neighbouring eigenvalues that is no multiplet's: many times what elements split one by.
_GAP = 1e-3
#: Most iterations of LOBPCG.
_ITERATIONS = 60


@dataclass(frozen=True)
class Pencil:
    """What a method works on: K and M (n, n), and ``K - σM`` factorised for a negative shift σ.

    ``nodes`` (n/3, 3) say where the unknowns lie.
    """

    stiffness: sp.csr_matrix
    mass: sp.csr_matrix
    shift: float
    nodes: np.ndarray
    factor: object


@dataclass(frozen=True)
class Found:
    """Eigenpairs below a gap: ``values`` (k,), ``vectors`` (n, k), ``residuals`` (k,), and the ``following`` value.

    ``solves`` counts right-hand sides solved, or applications of the preconditioner.
    """

    values: np.ndarray
    vectors: np.ndarray
    residuals: np.ndarray
    following: float
    solves: int

    @property
    def zeros(self) -> np.ndarray:
        """Which values (k,) are zero but for rounding: those of rigid motions."""
        return np.abs(self.values) < _ZERO * self.values[-1]

    @property
    def worst(self) -> float:
        """The largest residual of the others."""
        return float(self.residuals[~self.zeros].max())


def block_lanczos(
    pencil: Pencil, wanted: int, tolerance: float, rng: np.random.Generator, extra: int = 0
) -> Found:
    """Run block Lanczos on ``(K - σM)⁻¹ M`` with full reorthogonalisation in the M inner product.

    The space V grows by a block per pass; ``T = Vᵀ M (K - σM)⁻¹ M V`` gives Ritz values ``θ = 1/(λ - σ)``, and
    the residual of a Ritz vector ``u`` is ``f``, its last block row times the block F that links V to what would
    come next. Nothing is restarted: memory is two arrays of n by about four times the wanted modes.

    What is returned is ``(K - σM)⁻¹ M u / θ = u + f/θ``, a step of inverse iteration that costs no solve
    (Ericsson and Ruhe, Math. Comp. 35, 1251, 1980). It leaves the residual ``-M f / θ²`` of ``K u = λ M u``, free of
    the rough displacements that K would enlarge in that of ``u``. ``extra`` widens the blocks.
    """
    solve, mass, n = pencil.factor.solve, pencil.mass, pencil.mass.shape[0]
    block = max(_BLOCK, int(wanted * _BLOCK_SHARE)) + extra
    limit, goal = min(n - block, 16 * wanted), tolerance
    space, weighted = Columns(n, 4 * wanted), Columns(n, 4 * wanted)
    projected = np.zeros((0, 0))
    fresh, weighted_fresh, _ = orthonormalise(solve(mass @ rng.standard_normal((n, block))), mass)
    while True:
        old, width = space.size, fresh.shape[1]
        space.append(fresh)
        weighted.append(weighted_fresh)
        image = solve(weighted_fresh)
        column = clear(image, space.all, weighted.all)
        projected = np.pad(projected, (0, width))
        projected[:, old:] = column
        projected[old:, :] = column.T
        fresh, weighted_fresh, weighted_image = orthonormalise(image, mass)
        size, seen = space.size, min(wanted + _AHEAD, n)
        if size < seen:
            continue
        theta, mixing = scipy.linalg.eigh(projected, subset_by_index=(size - seen, size - 1))
        theta, mixing = theta[::-1], mixing[:, ::-1]
        values = pencil.shift + 1.0 / theta
        link = (fresh.T @ weighted_image) @ mixing[old:] / theta
        error = np.linalg.norm(link, axis=0)
        kept, distance = gap(values, wanted)
        # The next one must be known well enough to lie beyond the gap.
        if error[:kept].max() <= goal and error[kept] <= 0.25 * distance:
            weighted = None  # what follows needs the memory
            vectors = combine(space.all, mixing[:, :kept])
            vectors += combine(fresh, link[:, :kept])
            ritz, more = _smoothed(pencil, vectors, tolerance)
            found = Found(*ritz, float(values[kept]), block + size + more)
            # Where still more vectors would not help, rounding is the limit.
            if found.worst <= tolerance or goal < 0.05 * tolerance:
                return found
            goal *= 0.1
            weighted = Columns(n, 4 * wanted)
            weighted.append(product(mass, space.all))
        if size + width > limit:
            raise Refused(
                "solve_failed",
                f"Block Lanczos reached a residual of {error[:kept].max():.1e} only in {size} vectors.",
                "Raise basis.tolerance, or lower basis.modes.",
            )


def arpack(pencil: Pencil, wanted: int, tolerance: float, rng: np.random.Generator, extra: int = 0) -> Found:
    """Run SciPy's implicitly restarted Lanczos, one vector at a time, on the same operator; ``extra`` adds vectors."""
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

    n, solves = pencil.mass.shape[0], 0
    pairs = min(wanted + _AHEAD, n - 2)

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

    Published work uses it because it gets by with less than a factorisation; with an incomplete one it fails on thin
    bodies. The rigid motions are known and constrain it. ``extra`` adds vectors to the block.
    """
    from scipy.sparse.linalg import LinearOperator
    from scipy.sparse.linalg import lobpcg as scipys

    n, solves = pencil.mass.shape[0], 0

    def precondition(b):
        nonlocal solves
        solves += b.size // n
        return pencil.factor.solve(b)

    rigid, weighted_rigid, _ = orthonormalise(rigid_modes(pencil.nodes), pencil.mass)
    pairs = min(wanted - RIGID + _AHEAD, n - RIGID - 2) + extra
    # LOBPCG bounds ‖K u - ω² M u‖; -σ is about half the size of the first elastic ω², rigid motions tell that of ‖M u‖.
    size = -pencil.shift * np.linalg.norm(weighted_rigid, axis=0).min()
    with warnings.catch_warnings():
        # It warns where it does not converge; who calls looks at the residuals.
        warnings.simplefilter("ignore")
        _, vectors = scipys(
            pencil.stiffness,
            rng.standard_normal((n, pairs)),
            B=pencil.mass,
            M=LinearOperator((n, n), matvec=precondition, matmat=precondition, dtype=float),
            Y=rigid,
            largest=False,
            tol=tolerance * size,
            maxiter=_ITERATIONS,
        )
    return _until_gap(pencil, np.hstack([rigid, vectors]), wanted, tolerance, solves)


def gap(values: np.ndarray, wanted: int) -> tuple[int, float]:
    """Return how many of the ascending ``values`` to keep, ``wanted`` or a few more, so as to end at a gap.

    And the relative width of that gap. It is the first that is wide enough, or the widest that is seen.
    """
    distances = np.diff(values[wanted - 1 :]) / values[wanted - 1 : -1]
    wide = distances > _GAP
    first = int(np.argmax(wide if wide.any() else distances))
    return wanted + first, float(distances[first])


def _smoothed(pencil: Pencil, vectors: np.ndarray, tolerance: float):
    """Return the Ritz pairs of ``vectors`` and their residuals, and how many took a solve because theirs was too large.

    What orthogonalising enlarges of rounding is rough, and K makes it the residual of the lowest modes of thin bodies.
    """
    ritz = rayleigh_ritz(vectors, pencil.stiffness, pencil.mass)
    values, vectors, residuals = ritz
    rough = (residuals > tolerance) & (np.abs(values) > _ZERO * values[-1])
    if rough.any():
        vectors[:, rough] = pencil.factor.solve(pencil.mass @ vectors[:, rough])
        ritz = rayleigh_ritz(vectors, pencil.stiffness, pencil.mass)
    return ritz, int(rough.sum())


def _until_gap(pencil: Pencil, vectors: np.ndarray, wanted: int, tolerance: float, solves: int) -> Found:
    """Return the Ritz pairs of more vectors than wanted, up to a gap."""
    (values, vectors, residuals), more = _smoothed(pencil, vectors, tolerance)
    kept, _ = gap(values, wanted)
    return Found(values[:kept], vectors[:, :kept], residuals[:kept], float(values[kept]), solves + more)
