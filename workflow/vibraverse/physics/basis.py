"""The material-independent modal basis of a body.

With E = ρ = 1 and the mesh in its own units, everything but Poisson's ratio ν is scaling. So the sparse problem is
solved at a few nodes of ν, the modes found there are joined into one M-orthonormal basis U, free of rigid
motions, and the operators are projected once:

    A_λ = Uᵀ K_λ U,   A_μ = Uᵀ K_μ U,   Uᵀ M U = I.

For any material the dense problem ``(λ A_λ + μ A_μ) c = ω² c`` of a few hundred unknowns is what remains
(Rayleigh–Ritz, so frequencies are bounded from below by the exact ones of the mesh).

The error of that reduction is known without the big matrices. The residual of a Ritz pair, ``r = λ K_λ U c + μ K_μ U c
- ω² M U c``, is linear in three blocks W = [K_λ U, K_μ U, M U]; with the Gram matrix ``G = Wᵀ B⁻¹ W`` of the
energy norm ``B = K(ν_mid) - σM`` its size costs a small dense product for every later material.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.physics.eigensolver import RIGID, fix_signs, orthonormalise, project, solve
from vibraverse.physics.elasticity import Operators, assemble, lame, rigid_modes
from vibraverse.physics.factorisation import factorise

#: Modes solved for beyond those kept: where spectra cross between the nodes of ν, a mode just above the last
#: one kept at a node is among those kept elsewhere.
_GUARD = 8


@dataclass(frozen=True)
class ModalBasis:
    """The modal basis of one body, in mesh units with E = ρ = 1.

    ``a_lambda``, ``a_mu``: (r, r) reduced stiffness; ``gram``: (3r, 3r) residual norms, ``energy_poisson`` the ν of
    their norm; ``vertices`` (V, 3), ``faces`` (F, 3): the surface; ``surface``: (V, 3, r) the basis on its vertices;
    ``poisson_nodes`` in the order solved and ``residuals`` (nodes, m) of those solves; ``volume``, ``centre`` (3,) and
    ``inertia`` (3, 3) about it for unit density.
    """

    a_lambda: np.ndarray
    a_mu: np.ndarray
    gram: np.ndarray
    energy_poisson: float
    vertices: np.ndarray
    faces: np.ndarray
    surface: np.ndarray
    poisson_nodes: np.ndarray
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


def build_basis(
    points: np.ndarray,
    cells: np.ndarray,
    *,
    rng: np.random.Generator,
    order: int = 2,
    modes: int = 64,
    poisson_nodes=(0.1, 0.2, 0.3, 0.4),
    method: str = "auto",
    factorisation: str = "auto",
    tolerance: float = 1e-5,
) -> ModalBasis:
    """Solve for the modal basis of a tetrahedral mesh.

    ``points`` (N, 3) and ``cells`` (T, 4) in any length unit, ``modes`` elastic modes at every node of Poisson's ratio.
    Frequencies scale with ``sqrt(E/ρ)`` over that unit.

    Raises :class:`vibraverse.refusal.Refused` where the mesh is invalid or the solve fails.
    """
    operators = assemble(points, cells, order)
    solved = min(modes + _GUARD, max(modes, operators.unknowns - RIGID - 2))
    # The node nearest the middle comes last: its factorisation serves the residual norms too.
    nodes = np.asarray(poisson_nodes, dtype=float)
    nodes = nodes[np.argsort(-np.abs(nodes - np.median(nodes)), kind="stable")]
    found, residuals, factor = [], [], None
    for poisson in nodes:
        pairs = solve(
            operators,
            float(poisson),
            solved,
            rng=rng,
            method=method,
            factorisation=factorisation,
            tolerance=tolerance,
            factor=factor,
        )
        factor = pairs.factor
        found.append(pairs.vectors)
        residuals.append(pairs.residuals[:modes])
    space = _join(found, operators)
    energy_poisson = float(nodes[-1])
    gram = _residual_gram(space, operators, energy_poisson, pairs.shift, factor, factorisation)
    faces, surface_nodes = boundary(cells)
    volume, centre, inertia = rigid_body(operators)
    return ModalBasis(
        a_lambda=project(space, operators.k_lambda),
        a_mu=project(space, operators.k_mu),
        gram=gram,
        energy_poisson=energy_poisson,
        vertices=points[surface_nodes],
        faces=faces,
        surface=space.reshape(-1, 3, space.shape[1])[_positions(cells, surface_nodes)],
        poisson_nodes=nodes,
        residuals=np.stack(residuals),
        volume=volume,
        centre=centre,
        inertia=inertia,
        order=order,
        n_vertices=operators.n_vertices,
        n_tetrahedra=len(cells),
        n_unknowns=operators.unknowns,
        method=pairs.method,
        factorisation=getattr(factor, "name", "none"),
    )


def _join(found: list[np.ndarray], operators: Operators) -> np.ndarray:
    """Join the modes of all nodes into one M-orthonormal basis without rigid motions."""
    rigid, weighted_rigid, _ = orthonormalise(rigid_modes(operators.nodes), operators.mass)
    space = np.concatenate(found, axis=1)
    space -= rigid @ (weighted_rigid.T @ space)
    # Directions ten orders below the rest are copies of modes that do not depend on ν.
    space, _, _ = orthonormalise(space, operators.mass, drop=1e-10)
    return fix_signs(space)


def _residual_gram(space, operators: Operators, poisson: float, shift: float, factor, factorisation):
    """Return the Gram matrix of ``[K_λ U, K_μ U, M U]`` in the norm of ``B⁻¹``, ``B = K(ν) - σM``.

    ``factor`` is the factorisation of B, or None.
    """
    lam, mu = lame(1.0, poisson)
    if factor is None:
        factor = factorise(operators.shifted(lam, mu, shift), factorisation)
    parts = [operators.k_lambda @ space, operators.k_mu @ space, operators.mass @ space]
    solved_lambda, solved_mass = factor.solve(parts[0]), factor.solve(parts[2])
    # (λ K_λ + μ K_μ - σ M) U = B U, so the third solve follows from the other two.
    solved_mu = (space - lam * solved_lambda + shift * solved_mass) / mu
    gram = np.block([[left.T @ right for right in (solved_lambda, solved_mu, solved_mass)] for left in parts])
    return 0.5 * (gram + gram.T)


def boundary(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the boundary of tetrahedra (T, 4): triangles (F, 3), outward, and the points they use (V,).

    The triangles index into those points, which ascend.
    """
    faces = cells[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    faces = faces[np.sort(first[count == 1])]
    nodes, index = np.unique(faces, return_inverse=True)
    return index.reshape(-1, 3).astype(np.int32), nodes


def _positions(cells: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return where the given points stand among those that the cells use."""
    return np.searchsorted(np.unique(cells), nodes)


def rigid_body(operators: Operators) -> tuple[float, np.ndarray, np.ndarray]:
    """Return volume, centre of mass (3,) and inertia tensor (3, 3) about it, for unit density."""
    nodes, mass = operators.nodes, operators.mass
    n = len(nodes)
    scalar = np.zeros((n, 3, 4))
    scalar[:, 0, 0] = 1.0
    scalar[:, 0, 1:] = nodes
    fields = scalar.reshape(3 * n, 4)
    moments = fields.T @ (mass @ fields)
    volume = moments[0, 0]
    centre = moments[0, 1:] / volume
    second = moments[1:, 1:] - volume * np.outer(centre, centre)
    return float(volume), centre, np.trace(second) * np.eye(3) - second
