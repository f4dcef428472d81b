"""Linear isotropic elasticity on tetrahedra: stiffness and mass matrices.

With ``λ = Eν/((1+ν)(1-2ν))`` and ``μ = E/(2(1+ν))`` the weak form is

    ∫ λ (div u)(div v) + μ (∇u + ∇uᵀ) : ∇v = ω² ∫ ρ u · v,

so ``K = λ K_λ + μ K_μ`` and ``M = ρ M_1``, where the three matrices depend only on the mesh. They are
contracted for many elements at once from scikit-fem's scalar basis. With ``D_ij^ab = ∫ ∂_a φ_i ∂_b φ_j`` the
3×3 block that couples nodes i and j is

    K_λ: D^ab,      K_μ: δ_ab tr D + D^ba,      M_1: δ_ab ∫ φ_i φ_j.

Unknowns are interleaved: component ``a`` of node ``i`` has number ``3 i + a``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from vibraverse.contract.errors import Refused

if TYPE_CHECKING:
    from skfem import MeshTet

#: Elements contracted at once, which limits the memory to a few hundred megabytes.
_BLOCK_ELEMENTS = 8192


@dataclass(frozen=True)
class Operators:
    """The matrices of one mesh, for unit density: ``K = lam * k_lambda + mu * k_mu``.

    ``k_lambda``, ``k_mu`` and ``mass`` (n, n) are sparse and symmetric. ``nodes`` (n/3, 3) are the coordinates of the
    nodes; the first ``n_vertices`` are the points of the mesh, in order. ``volume`` is in mesh units. ``mass_data``
    holds the entries of ``mass`` on the sparsity pattern of the stiffness. ``mesh`` is scikit-fem's, with ascending
    vertices in each element, and ``element_nodes`` (T, 4 or 10) are its nodes in scikit-fem's order.
    """

    k_lambda: sp.csr_matrix
    k_mu: sp.csr_matrix
    mass: sp.csr_matrix
    mass_data: np.ndarray
    nodes: np.ndarray
    n_vertices: int
    volume: float
    order: int
    mesh: MeshTet
    element_nodes: np.ndarray

    @property
    def unknowns(self) -> int:
        """Number of unknowns n."""
        return self.mass.shape[0]

    def stiffness(self, lam: float, mu: float) -> sp.csr_matrix:
        """Return ``lam * k_lambda + mu * k_mu``; both share one sparsity pattern."""
        return self._on_pattern(lam * self.k_lambda.data + mu * self.k_mu.data)

    def shifted(self, lam: float, mu: float, shift: float) -> sp.csr_matrix:
        """Return ``lam * k_lambda + mu * k_mu - shift * mass``, always on the same sparsity pattern."""
        data = lam * self.k_lambda.data + mu * self.k_mu.data - shift * self.mass_data
        return self._on_pattern(data)

    def _on_pattern(self, data: np.ndarray) -> sp.csr_matrix:
        return sp.csr_matrix((data, self.k_mu.indices, self.k_mu.indptr), shape=self.k_mu.shape)


def check_tetrahedra(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the volumes (T,) of tetrahedra; raises :class:`Refused` unless all are positive."""
    corners = points[cells]
    volumes = (
        np.einsum(
            "ti,ti->t",
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
            corners[:, 3] - corners[:, 0],
        )
        / 6.0
    )
    if len(cells) == 0 or not np.isfinite(volumes).all():
        raise Refused(
            "solve_failed",
            "The mesh has no tetrahedra, or coordinates that are not finite numbers.",
            "Delete tets.msh, so that the next run makes it again.",
        )
    # A volume twelve digits below the mean is a rounding error, not geometry.
    bad = int((volumes <= 1e-12 * np.abs(volumes).mean()).sum())
    if bad:
        raise Refused(
            "solve_failed",
            f"{bad} of {len(cells)} tetrahedra have zero or negative volume.",
            "Change tets.target_elements, so that the body is meshed with other elements.",
        )
    return volumes


def assemble(points: np.ndarray, cells: np.ndarray, order: int = 2) -> Operators:
    """Assemble the operators of a tetrahedral mesh.

    ``points`` (N, 3), ``cells`` (T, 4) positively oriented, ``order`` 1 or 2. Quadrature is exact for the order.

    Raises :class:`Refused` for elements of zero or negative volume.
    """
    from skfem import Basis, ElementTetP1, ElementTetP2, MeshTet

    volumes = check_tetrahedra(points, cells)
    used = np.unique(cells)
    if len(used) != len(points):
        renumber = np.full(len(points), -1)
        renumber[used] = np.arange(len(used))
        points, cells = points[used], renumber[cells]

    element = {1: ElementTetP1, 2: ElementTetP2}[order]()
    # Ascending vertices give every edge the same direction in all its elements. The forms ignore the orientation.
    ascending = np.sort(cells, axis=1).T.astype(np.int64)
    mesh = MeshTet(np.ascontiguousarray(points.T, dtype=float), np.ascontiguousarray(ascending))
    parts = [
        (
            Basis(mesh, element, intorder=max(2 * order - 2, 1), elements=chunk),
            Basis(mesh, element, intorder=2 * order, elements=chunk),
        )
        for chunk in np.array_split(np.arange(len(cells)), -(-len(cells) // _BLOCK_ELEMENTS))
    ]
    first = parts[0][0]
    n = first.N
    dofs = np.concatenate([stiff.element_dofs for stiff, _ in parts], axis=1).T  # (T, k)

    # The position of every (element, i, j) in the pattern of node pairs, which all three matrices share.
    pairs = dofs[:, :, None].astype(np.int64) * n + dofs[:, None, :]
    unique, position = np.unique(pairs, return_inverse=True)
    position = position.ravel()
    indices = (unique % n).astype(np.int32)
    indptr = np.searchsorted(unique // n, np.arange(n + 1)).astype(np.int32)

    size = len(unique)
    d = np.zeros((3, 3, size))
    m = np.zeros(size)
    start = 0
    for stiff, mass in parts:
        grad = np.stack([shape[0].grad for shape in stiff.basis])  # (k, 3, T, q)
        value = np.stack(
            [np.broadcast_to(np.asarray(shape[0]), mass.dx.shape) for shape in mass.basis]
        )  # (k, T, q)
        count = stiff.dx.shape[0]
        stop = start + count * dofs.shape[1] ** 2
        here = position[start:stop]
        weighted = grad * stiff.dx
        for a in range(3):
            for b in range(3):
                block = np.einsum("itq,jtq->tij", weighted[:, a], grad[:, b], optimize=False)
                d[a, b] += np.bincount(here, block.ravel(), size)
        block = np.einsum("itq,jtq->tij", value * mass.dx, value, optimize=False)
        m += np.bincount(here, block.ravel(), size)
        start = stop

    def matrix(blocks: np.ndarray) -> sp.csr_matrix:
        return sp.bsr_matrix((blocks, indices, indptr), shape=(3 * n, 3 * n)).tocsr()

    eye = np.eye(3)
    mass = matrix(m[:, None, None] * eye)
    mass_data = mass.data.copy()
    mass.eliminate_zeros()
    trace = d[0, 0] + d[1, 1] + d[2, 2]
    return Operators(
        k_lambda=matrix(np.ascontiguousarray(d.transpose(2, 0, 1))),
        k_mu=matrix(trace[:, None, None] * eye + d.transpose(2, 1, 0)),
        mass=mass,
        mass_data=mass_data,
        nodes=np.ascontiguousarray(first.doflocs.T),
        n_vertices=mesh.p.shape[1],
        volume=float(volumes.sum()),
        order=order,
        mesh=mesh,
        element_nodes=dofs,
    )


def rigid_modes(nodes: np.ndarray) -> np.ndarray:
    """Return the six rigid motions (n, 6) at the nodes (n/3, 3): three translations, three rotations.

    Both element orders contain linear fields, so ``K @ rigid_modes`` vanishes to rounding.
    """
    modes = np.zeros((len(nodes), 3, 6))
    x = nodes - nodes.mean(axis=0)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        modes[:, a, a] = 1.0
        modes[:, b, 3 + a] = -x[:, c]
        modes[:, c, 3 + a] = x[:, b]
    return modes.reshape(-1, 6)
