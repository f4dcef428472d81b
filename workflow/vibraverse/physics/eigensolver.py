"""The lowest eigenpairs of ``K u = ω² M u`` for a free body, proven to be complete.

All sparse methods work on ``(K - σM)⁻¹ M`` with a *negative* shift σ. Then ``K - σM`` is positive definite although
the six rigid motions are in the kernel of K, and no eigenvalue lies near the shift. (σ = 0, or a small positive shift
amid the rigid motions, can return wrong modes without any error.)

- ``lanczos``: block Lanczos with full reorthogonalisation; a block of right-hand sides costs little more than one.
- ``arpack``: SciPy's implicitly restarted Lanczos.
- ``lobpcg``: SciPy's LOBPCG, preconditioned by the same factorisation.
- ``dense``: LAPACK, for tiny meshes.

An iteration may miss pairs without noticing. So ``K - cM`` is factorised too, with c in a gap above the last pair: its
negative eigenvalues count the eigenvalues below c (Sylvester's law of inertia). Each Ritz value is an upper bound of an
eigenvalue, so equal counts prove that none is missing. Otherwise the problem is solved again.

The six rigid motions are computed like other modes (``lobpcg`` is given them), checked and counted, then dropped.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from vibraverse.contract.errors import Refused
from vibraverse.physics.columns import fix_signs, orthonormalise, project, residuals
from vibraverse.physics.elasticity import Operators, rigid_modes
from vibraverse.physics.factorisation import factorise
from vibraverse.physics.iterations import RIGID, Found, Pencil, arpack, block_lanczos, lobpcg
from vibraverse.physics.materials import lame

_METHODS = {"lanczos": block_lanczos, "arpack": arpack, "lobpcg": lobpcg}
#: LAPACK is faster than any sparse method up to this many unknowns.
_MAX_DENSE_UNKNOWNS = 900
#: Largest rigid eigenvalue as a share of the first elastic one.
_RIGID_TOLERANCE = 1e-4
#: Most attempts to find all pairs.
_MAX_ATTEMPTS = 3
#: Relative error up to which a factorisation must reproduce test vectors before its count is trusted.
_COUNT_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Eigenpairs:
    """The lowest elastic eigenpairs, ascending: ``values`` (m,) are ω², ``vectors`` (n, m), ``vectorsᵀ M vectors = I``.

    ``residuals`` (m,) are ``‖K u - ω² M u‖ / ‖ω² M u‖``. ``gap`` is the relative distance of the last value to the next
    one, near zero where a multiplet is cut. ``method`` is the one that ran. ``solves`` is the number of right-hand
    sides that it solved or preconditioned. ``attempts`` is the number of runs until the pairs were proven complete, and
    ``seconds`` the CPU time of all runs. ``shift`` is σ and ``factor`` the factorisation of ``K - σM`` for further
    solves, None for ``dense``.
    """

    values: np.ndarray
    vectors: np.ndarray
    residuals: np.ndarray
    gap: float
    method: str
    solves: int
    attempts: int
    seconds: float
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

    ``tolerance`` bounds the residual of every pair; eigenvalues are right to about its square.

    Raises :class:`Refused` when the mesh has too few unknowns or more than six rigid modes (several bodies), and when
    the iteration does not converge or keeps missing pairs.
    """
    began = time.process_time()
    n, wanted = operators.unknowns, modes + RIGID
    if n < wanted + 2:
        raise Refused(
            "solve_failed",
            f"The mesh has {n} unknowns, too few for {modes} elastic and {RIGID} rigid modes.",
            "Lower basis.modes, or raise tets.target_elements.",
        )
    stiffness, mass = operators.stiffness(*lame(1.0, poisson)), operators.mass
    if method == "auto":
        method = "lanczos" if n > _MAX_DENSE_UNKNOWNS and n > 6 * wanted else "dense"
    shift = shift_for(stiffness, mass, operators.nodes)
    attempts, factor = 1, None
    if method == "dense":
        found = _dense(stiffness, mass, wanted)
        _check_rigid(found, operators)
    else:
        factor = factorise(operators.shifted(*lame(1.0, poisson), shift), factorisation)
        pencil = Pencil(stiffness, mass, shift, operators.nodes, factor)
        found, attempts = _solve_completely(
            pencil, operators, poisson, wanted, method, factorisation, tolerance, rng
        )
    values = np.append(found.values, found.following)
    return Eigenpairs(
        values=found.values[RIGID:wanted],
        vectors=fix_signs(found.vectors[:, RIGID:wanted]),
        residuals=found.residuals[RIGID:wanted],
        gap=float(values[wanted] / values[wanted - 1] - 1),
        method=method,
        solves=found.solves,
        attempts=attempts,
        seconds=time.process_time() - began,
        shift=shift,
        factor=factor,
    )


def shift_for(stiffness: sp.csr_matrix, mass: sp.csr_matrix, nodes: np.ndarray) -> float:
    """Return a negative shift of the magnitude of the first elastic eigenvalue.

    Displacements quadratic in the coordinates give an upper bound of that eigenvalue (Rayleigh–Ritz). Half of the bound
    is small compared with the wanted spectrum and large compared with rounding.
    """
    x = nodes - nodes.mean(axis=0)
    x = x / np.abs(x).max()
    quadratic = [x[:, a] * x[:, b] for a in range(3) for b in range(a, 3)]
    scalars = np.stack([np.ones(len(x)), *x.T, *quadratic], axis=1)
    fields, _, _ = orthonormalise(np.kron(scalars, np.eye(3)), mass)
    return -0.5 * float(np.linalg.eigvalsh(project(fields, stiffness))[RIGID])


def count_below(
    operators: Operators, poisson: float, cut: float, near: np.ndarray, factorisation: str = "auto", like=None
) -> int:
    """Return how many eigenvalues lie below ``cut``, those of rigid motions included.

    ``near`` (n, k) are test vectors, among them eigenvectors of eigenvalues next to ``cut``. If the factorisation
    reproduces them, it belongs to a matrix so close that no eigenvalue crosses ``cut``. It reuses the ordering of the
    factorisation ``like`` where possible.

    Raises :class:`Refused` if rounding leaves the count in doubt.
    """
    matrix = operators.shifted(*lame(1.0, poisson), cut)
    size = np.vecdot(near.T, (operators.mass @ near).T)
    for matched in (False, True):
        factor = factorise(matrix, factorisation, definite=False, like=like, matched=matched)
        count, error = factor.negative_pivots, factor.solve(matrix @ near) - near
        factor.free()
        if (np.vecdot(error.T, (operators.mass @ error).T) <= _COUNT_TOLERANCE**2 * size).all():
            return count
    raise Refused(
        "solve_failed",
        "A factorisation lost too many digits to count the modes.",
        "Change tets.target_elements, so that the body is meshed with other elements.",
    )


def _solve_completely(
    pencil: Pencil,
    operators: Operators,
    poisson: float,
    wanted: int,
    method: str,
    factorisation: str,
    tolerance: float,
    rng: np.random.Generator,
) -> tuple[Found, int]:
    """Run a method until its pairs are proven complete; return them and the number of runs."""
    missing = 0
    for attempt in range(1, _MAX_ATTEMPTS + 1):
        found = _METHODS[method](pencil, wanted, tolerance, rng, extra=missing)
        _check_rigid(found, operators)
        if found.worst > tolerance:
            raise Refused(
                "solve_failed",
                f"The eigensolver {method} reached a residual of {found.worst:.1e} instead of {tolerance:.0e}.",
                "Raise basis.tolerance, or choose another basis.method.",
            )
        cut = 0.5 * (found.values[-1] + found.following)
        near = np.stack([found.vectors[:, -1], rng.standard_normal(operators.unknowns)], axis=1)
        count = count_below(operators, poisson, cut, near, factorisation, pencil.factor)
        missing = abs(count - len(found.values))
        if missing == 0:
            return found, attempt
    raise Refused(
        "solve_failed",
        f"The eigensolver {method} found {len(found.values)} modes below ω² = {cut:.6g}, which is wrong by {missing}.",
        "Choose another basis.method.",
    )


def _dense(stiffness: sp.csr_matrix, mass: sp.csr_matrix, wanted: int) -> Found:
    values, vectors = scipy.linalg.eigh(stiffness.toarray(), mass.toarray(), subset_by_index=(0, wanted))
    following, values, vectors = float(values[-1]), values[:-1], vectors[:, :-1]
    return Found(values, vectors, residuals(stiffness, mass, values, vectors), following, 0)


def _check_rigid(found: Found, operators: Operators) -> None:
    """Raise :class:`Refused` unless exactly the six rigid motions have the eigenvalue zero."""
    values, vectors = found.values, found.vectors
    zeros = int(found.zeros.sum())
    if zeros > RIGID:
        raise Refused(
            "solve_failed",
            f"The body has at least {zeros} rigid modes instead of {RIGID}: its tetrahedra are not one connected body.",
            "Keep one part of the mesh, or join the parts.",
        )
    _, rigid, _ = orthonormalise(rigid_modes(operators.nodes), operators.mass)
    overlap = np.linalg.svd(rigid.T @ vectors[:, :RIGID], compute_uv=False)
    if np.abs(values[:RIGID]).max() > _RIGID_TOLERANCE * values[RIGID] or overlap.min() < 1 - 1e-6:
        raise Refused(
            "solve_failed",
            f"The six lowest modes are not the rigid motions (|ω²| up to {np.abs(values[:RIGID]).max():.1e} "
            f"beside {values[RIGID]:.1e} of the first elastic mode).",
            "Raise tets.target_elements: the body is too thin for its mesh.",
        )
