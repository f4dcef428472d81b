"""The lowest eigenpairs of ``K u = ω² M u`` for a free body.

All sparse methods work on ``(K - σM)⁻¹ M`` with a *negative* shift σ: ``K - σM`` is positive definite
even though K has the six rigid motions in its kernel, and no eigenvalue can hide near the shift. (σ = 0 or a small
positive shift amid the rigid motions can return wrong modes without any error.)

``lanczos``: block Lanczos with full reorthogonalisation; a solve with twenty right-hand sides costs a few
times one with a single one. ``arpack``: SciPy's implicitly restarted Lanczos. ``dense``: LAPACK, for tiny meshes.

The six rigid motions are computed like every other mode, checked and counted, then dropped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from vibraverse.physics.columns import Columns
from vibraverse.physics.elasticity import Operators, lame, rigid_modes
from vibraverse.physics.factorisation import factorise
from vibraverse.refusal import Refused

RIGID = 6
#: Below this many unknowns LAPACK is faster than anything sparse.
_DENSE_UNKNOWNS = 900
#: A rigid eigenvalue vanishes to this fraction of the first elastic one.
_RIGID_TOLERANCE = 1e-4
#: Vectors per pass of block Lanczos; also the largest multiplicity found in one go.
_BLOCK = 20
#: Where orthogonalising leaves less than this of a vector, rounding is felt and it is done twice.
_CANCELLED = 1e-4
#: A Gram matrix with eigenvalues closer than this is inverted without loss that matters.
_WELL_CONDITIONED = 1e-3


@dataclass(frozen=True)
class Eigenpairs:
    """Elastic eigenpairs, ascending: ``values`` (m,) are ω², ``vectors`` (n, m) with ``vectorsᵀ M vectors = I``.

    ``residuals`` (m,) are ``‖K u - ω² M u‖ / ‖ω² M u‖``; ``method`` is the one that ran; ``shift`` is σ
    and ``factor`` the factorisation of ``K - σM`` (None for ``dense``), for more solves with it.
    """

    values: np.ndarray
    vectors: np.ndarray
    residuals: np.ndarray
    method: str
    shift: float
    factor: object | None


def solve(
    operators: Operators,
    poisson: float,
    modes: int,
    *,
    rng: np.random.Generator,
    method: str = "auto",
    factorisation: str = "auto",
    tolerance: float = 1e-5,
) -> Eigenpairs:
    """Return the ``modes`` lowest elastic eigenpairs for ``E = ρ = 1`` and Poisson's ratio ``poisson``.

    ``tolerance`` bounds the relative residual of every pair of the inverted operator; eigenvalues are right
    to about its square.

    Raises :class:`Refused` when the mesh has too few unknowns, is not one body (more than six rigid modes), or
    the iteration does not converge.
    """
    n, wanted = operators.unknowns, modes + RIGID
    if n < wanted + 2:
        raise Refused(
            "solve_failed",
            f"the mesh has {n} unknowns, too few for {modes} elastic and {RIGID} rigid modes.",
            "Ask for fewer modes or mesh finer.",
        )
    stiffness, mass = operators.stiffness(*lame(1.0, poisson)), operators.mass
    if method == "auto":
        method = "lanczos" if n > _DENSE_UNKNOWNS and n > 6 * wanted else "dense"
    shift = shift_for(stiffness, mass, operators.nodes)
    if method == "dense":
        factor = None
        values, vectors = scipy.linalg.eigh(
            stiffness.toarray(), mass.toarray(), subset_by_index=(0, wanted - 1)
        )
    else:
        factor = factorise(operators.shifted(*lame(1.0, poisson), shift), factorisation)
        iterate = {"lanczos": _block_lanczos, "arpack": _arpack}[method]
        values, vectors = iterate(stiffness, mass, factor, shift, wanted, tolerance, rng)
    _check_rigid(values, vectors, operators)
    values, vectors = values[RIGID:], fix_signs(vectors[:, RIGID:])
    return Eigenpairs(values, vectors, residuals(stiffness, mass, values, vectors), method, shift, factor)


def shift_for(stiffness: sp.csr_matrix, mass: sp.csr_matrix, nodes: np.ndarray) -> float:
    """Return a negative shift of the size of the first elastic eigenvalue.

    Displacements that are quadratic in the coordinates bound that eigenvalue from above (Rayleigh–Ritz); half of
    the bound is small against the wanted spectrum and large against rounding.
    """
    x = nodes - nodes.mean(axis=0)
    x = x / np.abs(x).max()
    quadratic = [x[:, a] * x[:, b] for a in range(3) for b in range(a, 3)]
    scalars = np.stack([np.ones(len(x)), *x.T, *quadratic], axis=1)
    fields, _, _ = orthonormalise(np.kron(scalars, np.eye(3)), mass)
    return -0.5 * float(np.linalg.eigvalsh(project(fields, stiffness))[RIGID])


def _arpack(stiffness, mass, factor, shift, wanted, tolerance, rng):
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

    n = stiffness.shape[0]
    try:
        values, vectors = eigsh(
            stiffness,
            k=wanted,
            M=mass,
            sigma=shift,
            OPinv=LinearOperator((n, n), matvec=factor.solve, dtype=float),
            v0=rng.standard_normal(n),
            tol=tolerance,
            ncv=min(n - 1, int(2.2 * wanted)),
        )
    except ArpackNoConvergence as error:
        raise Refused("solve_failed", f"ARPACK did not converge: {error}") from None
    order = np.argsort(values)
    return values[order], vectors[:, order]


def _block_lanczos(stiffness, mass, factor, shift, wanted, tolerance, rng):
    """Run block Lanczos on ``(K - σM)⁻¹ M`` with full reorthogonalisation in the M inner product.

    The space V grows by a block per pass; ``T = Vᵀ M (K - σM)⁻¹ M V`` gives Ritz values ``θ = 1/(λ - σ)``, and
    the residual of a Ritz pair is the norm of the last block row of its vector times the block that links V to what
    would come next. Nothing is restarted: memory is two arrays of n by about four times the wanted modes.
    """
    n = stiffness.shape[0]
    limit = min(n - _BLOCK, 16 * wanted)
    space, weighted = Columns(n, 5 * wanted), Columns(n, 5 * wanted)
    projected = np.zeros((0, 0))
    fresh, weighted_fresh, _ = orthonormalise(factor.solve(mass @ rng.standard_normal((n, _BLOCK))), mass)
    while True:
        old, width = space.size, fresh.shape[1]
        space.append(fresh)
        weighted.append(weighted_fresh)
        image = factor.solve(weighted_fresh)
        before = np.linalg.norm(image, axis=0)
        column = weighted.all.T @ image
        image -= space.all @ column
        if (np.linalg.norm(image, axis=0) < _CANCELLED * before).any():
            correction = weighted.all.T @ image
            image -= space.all @ correction
            column += correction
        projected = np.pad(projected, (0, width))
        projected[:, old:] = column
        projected[old:, :] = column.T
        fresh, weighted_fresh, weighted_image = orthonormalise(image, mass)
        size = space.size
        if size >= wanted + _BLOCK or fresh.shape[1] == 0:
            theta, mixing = scipy.linalg.eigh(projected, subset_by_index=(size - wanted, size - 1))
            coupling = fresh.T @ weighted_image
            error = np.linalg.norm(coupling @ mixing[old:], axis=0) / theta
            if error.max() <= tolerance or fresh.shape[1] == 0:
                return shift + 1.0 / theta[::-1], space.all @ mixing[:, ::-1]
            if size + _BLOCK > limit:
                raise Refused(
                    "solve_failed",
                    f"block Lanczos reached a residual of {error.max():.1e} only in {size} vectors.",
                    "Loosen basis.tolerance or ask for fewer modes.",
                )


def project(space: np.ndarray, matrix: sp.csr_matrix) -> np.ndarray:
    """Return ``spaceᵀ matrix space``, exactly symmetric."""
    projected = space.T @ (matrix @ space)
    return 0.5 * (projected + projected.T)


def orthonormalise(space: np.ndarray, mass: sp.csr_matrix):
    """Return an M-orthonormal basis Q of the columns' span, ``M Q`` and ``M space``.

    Columns are scaled to unit length; directions of their Gram matrix that are rounding are left out. A second pass
    removes what rounding left of the first, where that is more than a few digits.
    """
    weighted_space = weighted = mass @ space
    for limit in (1e-14, 1e-3):
        gram = space.T @ weighted
        scale = 1.0 / np.sqrt(np.diag(gram))
        weights, vectors = scipy.linalg.eigh(gram * scale[:, None] * scale)
        keep = weights > limit * weights[-1]
        turn = scale[:, None] * vectors[:, keep] / np.sqrt(weights[keep])
        space, weighted = space @ turn, weighted @ turn
        if weights[0] > _WELL_CONDITIONED * weights[-1]:
            break
    return space, weighted, weighted_space


def residuals(stiffness, mass, values: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return ``‖K u - ω² M u‖ / ‖ω² M u‖`` of every pair (Euclidean norms)."""
    inertia = (mass @ vectors) * values
    return np.linalg.norm(stiffness @ vectors - inertia, axis=0) / np.linalg.norm(inertia, axis=0)


def fix_signs(vectors: np.ndarray) -> np.ndarray:
    """Return the columns with the sign that makes the largest entry positive."""
    return vectors * signs(vectors)


def signs(vectors: np.ndarray) -> np.ndarray:
    """Return the sign of the largest entry of every column, (m,): 1 or -1."""
    largest = vectors[np.argmax(np.abs(vectors), axis=0), np.arange(vectors.shape[1])]
    return np.where(largest < 0, -1.0, 1.0)


def _check_rigid(values: np.ndarray, vectors: np.ndarray, operators: Operators) -> None:
    """Check that the six rigid motions, and nothing else, have eigenvalue zero."""
    zeros = int((np.abs(values) < 1e-8 * values[-1]).sum())
    if zeros > RIGID:
        raise Refused(
            "solve_failed",
            f"the body has at least {zeros} rigid modes instead of {RIGID}: its tetrahedra are not one connected body.",
            "Keep one part of the mesh, or join the parts.",
        )
    _, rigid, _ = orthonormalise(rigid_modes(operators.nodes), operators.mass)
    overlap = np.linalg.svd(rigid.T @ vectors[:, :RIGID], compute_uv=False)
    if np.abs(values[:RIGID]).max() > _RIGID_TOLERANCE * values[RIGID] or overlap.min() < 1 - 1e-6:
        raise Refused(
            "solve_failed",
            f"the six lowest modes are not the rigid motions (|ω²| up to {np.abs(values[:RIGID]).max():.1e} "
            f"beside {values[RIGID]:.1e} of the first elastic mode).",
            "The body is too thin for its mesh; mesh it finer.",
        )
