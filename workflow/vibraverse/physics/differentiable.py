"""Derivatives of eigenvalues with respect to the vertices of a mesh and to the material.

For an M-normalised mode u, ``dω² = uᵀ (dK - ω² dM) u`` with u held fixed (Hellmann and Feynman). Where vertices move by
a field θ that is linear in each tetrahedron, and quadratic elements keep their sides straight, this is exactly

    dω² = ∫ (σ:∇u - ω² |u|²) div θ - 2 σ:(∇u ∇θ),   σ = λ div u I + μ (∇u + ∇uᵀ),   ρ = 1.

A single eigenvalue of a cluster has no derivative: where two are equal, any mixture of their modes is a mode. Only
symmetric functions of the cluster have one, so each of its members gets that of their mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.physics.elasticity import Operators

#: Relative distance below which neighbouring eigenvalues form a cluster.
CLUSTER = 1e-4
#: Elements and modes whose gradients are in memory at once: a hundred megabytes.
_AT_ONCE = 40_000


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of the eigenvalues ω² (m,): with respect to vertices (m, V, 3), λ (m,) and μ (m,).

    ``clusters`` (m,) numbers the cluster of each; its members have the derivatives of their mean.
    """

    vertices: np.ndarray
    lam: np.ndarray
    mu: np.ndarray
    clusters: np.ndarray


def derivatives(
    operators: Operators,
    lam: float,
    mu: float,
    values: np.ndarray,
    vectors: np.ndarray,
    cluster: float = CLUSTER,
) -> Derivatives:
    """Return the derivatives of eigenvalues ``values`` (m,), ascending, with M-orthonormal modes ``vectors`` (3n, m).

    ``lam`` and ``mu`` are those of the stiffness that they belong to, for unit density. The vertices are those of
    ``operators.mesh``.
    """
    members = clusters(values, cluster)
    found = np.zeros((len(values), operators.n_vertices, 3))
    for elements, gradients, tensors in _tensors(operators, lam, mu, values, vectors):
        # A vertex moves the points of its tetrahedra by its barycentric coordinate.
        pulls = np.einsum("tia,tcam->mtic", gradients, tensors, optimize=True)
        at = operators.mesh.t.T[elements].ravel()
        for component in range(3):
            for mode in range(len(values)):
                found[mode, :, component] += np.bincount(
                    at, pulls[mode, :, :, component].ravel(), operators.n_vertices
                )
    along = [np.vecdot(vectors, matrix @ vectors, axis=0) for matrix in (operators.k_lambda, operators.k_mu)]
    return Derivatives(*(_means(one, members) for one in (found, *along)), members)


def clusters(values: np.ndarray, tolerance: float = CLUSTER) -> np.ndarray:
    """Return the number (m,) of the cluster of each ascending eigenvalue."""
    apart = np.diff(values) > tolerance * np.abs(values[1:])
    return np.concatenate([[0], np.cumsum(apart)])


def _means(arrays: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Return arrays (m, …) with the mean over its cluster in place of each."""
    sums = np.zeros((members[-1] + 1, *arrays.shape[1:]))
    np.add.at(sums, members, arrays)
    counts = np.bincount(members).reshape(-1, *[1] * (arrays.ndim - 1))
    return (sums / counts)[members]


def _tensors(operators: Operators, lam: float, mu: float, values: np.ndarray, vectors: np.ndarray):
    """Yield elements (t,), gradients of their barycentric coordinates (t, 4, 3) and the tensors (t, 3, 3, m).

    A tensor is the integral over the element of ``(σ:∇u - ω² |u|²) I - 2 ∇uᵀ σ``.
    """
    from skfem import Basis, ElementTetP1, ElementTetP2

    order, mesh = operators.order, operators.mesh
    element = {1: ElementTetP1, 2: ElementTetP2}[order]()
    fields = vectors.reshape(-1, 3, vectors.shape[1])
    count = operators.element_nodes.shape[0]
    for elements in np.array_split(np.arange(count), -(-count * len(values) // _AT_ONCE)):
        stiff = Basis(mesh, element, intorder=max(2 * order - 2, 1), elements=elements)
        heavy = Basis(mesh, element, intorder=2 * order, elements=elements)
        flat = Basis(mesh, ElementTetP1(), intorder=1, elements=elements)
        local = fields[operators.element_nodes[elements]]  # (t, i, c, m)
        slopes = np.stack([shape[0].grad for shape in stiff.basis])  # (i, a, t, q)
        gradient = np.einsum("ticm,iatq->tqcam", local, slopes, optimize=True)  # ∂_a u_c
        stress = mu * (gradient + gradient.swapaxes(2, 3))
        trace = np.einsum("tqccm->tqm", gradient)
        for axis in range(3):
            stress[:, :, axis, axis] += lam * trace
        energy = np.einsum("tq,tqcam,tqcam->tm", stiff.dx, stress, gradient, optimize=True)
        shapes = np.stack([np.broadcast_to(np.asarray(shape[0]), heavy.dx.shape) for shape in heavy.basis])
        masses = np.einsum("itq,jtq,tq->tij", shapes, shapes, heavy.dx, optimize=True)
        inertia = np.einsum("tij,ticm,tjcm->tm", masses, local, local, optimize=True)
        tensors = -2.0 * np.einsum("tq,tqcam,tqcbm->tabm", stiff.dx, gradient, stress, optimize=True)
        for axis in range(3):
            tensors[:, axis, axis] += energy - values * inertia
        gradients = np.stack([shape[0].grad[:, :, 0] for shape in flat.basis]).transpose(2, 0, 1)
        yield elements, gradients, tensors
