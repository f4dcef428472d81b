"""The discretisation error of the elements: its estimate, and corrections that mostly remove it.

Quadratic elements of the default size leave frequencies one or two per cent too high, and more in thin walls. Nearly
all of that error lies in the *surplus*: the functions that elements of the next degree would add. To quadratic elements
these are a cubic for every edge and every face, to linear ones a quadratic for every edge. A solve in the larger space
would cost many times more. But its lowest modes are the known ones plus small corrections, and the operator on the
surplus is well conditioned on any mesh (hierarchical bases: Zienkiewicz, Gago and Kelly, Comput. Struct. 16, 53, 1983;
Bank and Smith, SIAM J. Numer. Anal. 30, 921, 1993). The residuals of the modes vanish on the elements' own functions.
Three steps of block conjugate gradients turn them into corrections. The preconditioner is the factorised operator on
the elements' own functions, with the 3×3 diagonal blocks of the surplus.

The corrections join the basis, and the reduced problem is solved again: Rayleigh–Ritz in the larger space. So a
corrected frequency lies between those of the mesh and of elements of the next degree (two-grid corrections of
eigenvalues: Xu and Zhou, Math. Comp. 70, 17, 2001).

Nothing is assembled. Element matrices follow from integrals over one reference tetrahedron, because the gradients of
barycentric coordinates are constant in an element. Single precision suffices for a correction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from vibraverse.physics.columns import orthonormalise, orthonormalising, signs
from vibraverse.physics.elasticity import Operators, rigid_modes
from vibraverse.physics.materials import lame

#: Steps of conjugate gradients; a fourth would lower frequencies by 1 to 10 % of what three do.
_CG_STEPS = 3
#: Directions below this share of the largest eigenvalue are rounding errors of single precision.
_ROUNDING_SHARE = 1e-6
#: Elements applied at once, which limits the memory for their vectors.
_BLOCK_ELEMENTS = 4096


@dataclass(frozen=True)
class Corrections:
    """Vectors that join a basis of r vectors, orthonormal in the mass of the larger space.

    ``vectors`` (n, m) are their values at the nodes. ``k_lambda`` and ``k_mu`` (r + m, m) are the last columns of the
    stiffness of the larger space, projected onto basis and corrections; ``mass`` (r, m) couples the two.
    """

    vectors: np.ndarray
    k_lambda: np.ndarray
    k_mu: np.ndarray
    mass: np.ndarray

    def turned(self, turn: np.ndarray) -> Corrections:
        """Return the corrections for a basis with coefficients ``turn`` (r, s) in the current one."""
        rank = len(turn)
        sides = (
            np.concatenate([turn.T @ matrix[:rank], matrix[rank:]]) for matrix in (self.k_lambda, self.k_mu)
        )
        return Corrections(self.vectors, *sides, turn.T @ self.mass)


def correct(
    operators: Operators,
    factor,
    shift: float,
    poisson: float,
    basis: np.ndarray,
    values: np.ndarray,
    modes: np.ndarray,
) -> Corrections:
    """Return the corrections of the Ritz pairs ``values`` (m,), ``modes`` (n, m) at a Poisson's ratio.

    ``basis`` (n, r) is free of rigid motions; ``factor`` solves with ``K(poisson) - shift M``.
    """
    space = _Surplus(operators)
    n, (lam, mu) = operators.unknowns, lame(1.0, poisson)
    modes, values = modes.astype(np.float32), values.astype(np.float32)
    stiffness, mass = space.elements(lam, mu, 0.0), space.elements(0.0, 0.0, 1.0)
    residual = space.on_surplus(mass, modes * values) - space.on_surplus(stiffness, modes)
    stiffness -= np.float32(shift) * mass
    own, smooth = operators.shifted(lam, mu, shift).astype(np.float32), space.inverse_diagonal(stiffness)
    found = _conjugate_gradients(
        lambda fields: space.apply(stiffness, own, fields),
        lambda fields: np.concatenate([factor.solve(fields[:n]).astype(np.float32), smooth(fields[n:])]),
        np.concatenate([np.zeros_like(modes), residual]),
        np.concatenate([np.zeros_like(modes), smooth(residual)]),
    )
    weighted = space.apply(mass, operators.mass, found)
    rigid, _, _ = orthonormalise(rigid_modes(operators.nodes), operators.mass)
    drift = rigid.T @ weighted[:n]
    vectors = found[:n] - rigid @ drift
    turn, _ = orthonormalising((found.T @ weighted - drift.T @ drift).astype(float), _ROUNDING_SHARE)
    turn = turn * signs(vectors @ turn)
    columns = []
    for matrix, unit in ((operators.k_lambda, (1.0, 0.0)), (operators.k_mu, (0.0, 1.0))):
        image = space.apply(space.elements(*unit, 0.0), matrix, found)
        corner = turn.T @ (found.T @ image) @ turn
        columns.append(np.concatenate([basis.T @ image[:n] @ turn, 0.5 * (corner + corner.T)]))
    return Corrections(vectors @ turn, *columns, basis.T @ weighted[:n] @ turn)


def _conjugate_gradients(operator, precondition, residual: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the solution (n, m) after a few steps from zero; ``direction`` is the preconditioned residual.

    All columns share their search directions, so the span of the solution depends only on the span of the residual. So
    modes of equal frequency get the same corrections, whichever combination of them a solver returns.
    """
    solution = np.zeros_like(residual)
    for step in range(_CG_STEPS):
        image = operator(direction)
        turn, _ = orthonormalising((direction.T @ image).astype(float), _ROUNDING_SHARE)
        direction, image = (fields @ turn.astype(np.float32) for fields in (direction, image))
        length = direction.T @ residual
        solution += direction @ length
        if step < _CG_STEPS - 1:
            residual = residual - image @ length
            fresh = precondition(residual)
            direction = fresh - direction @ (image.T @ fresh)
    return solution


class _Surplus:
    """The elements' own functions and the surplus: fields (n + s, m), values at the nodes first.

    :meth:`elements` returns the element matrices: rows for the surplus, columns for own functions and surplus.
    """

    def __init__(self, operators: Operators):
        mesh, order = operators.mesh, operators.order
        own = operators.element_nodes
        surplus = mesh.t2e if order == 1 else np.concatenate([mesh.t2e, mesh.t2f + mesh.edges.shape[1]])
        self._numbers = {True: surplus.T, False: own}
        self._counts = {True: int(surplus.max()) + 1, False: len(operators.nodes)}
        self._unknowns = operators.unknowns
        self._rows, self._own = 3 * len(surplus), 3 * own.shape[1]
        self._stiff, self._mass = _reference_integrals(order)
        corners = mesh.p.T[mesh.t.T]
        edges = corners[:, 1:] - corners[:, :1]
        self._volumes = np.abs(np.linalg.det(edges)) / 6.0
        gradients = np.linalg.inv(edges).transpose(0, 2, 1)
        self._gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)

    def elements(self, lam: float, mu: float, density: float) -> np.ndarray:
        """Return the matrices ``lam K_λ + mu K_μ + density M`` of all elements, (T, 3j, 3(k + j))."""
        rows, columns = self._mass.shape
        elements = np.zeros((len(self._volumes), rows, 3, columns, 3), dtype=np.float32)
        if lam or mu:
            pairs = np.einsum("t,tka,tlb->tabkl", self._volumes, self._gradients, self._gradients)
            d = pairs.reshape(-1, 16).astype(np.float32) @ self._stiff.T.astype(np.float32)
            d = d.reshape(-1, 3, 3, rows, columns)
            trace = d[:, 0, 0] + d[:, 1, 1] + d[:, 2, 2]
            for a in range(3):
                for b in range(3):
                    elements[:, :, a, :, b] = lam * d[:, a, b] + mu * d[:, b, a]
                elements[:, :, a, :, a] += mu * trace
        if density:
            scalar = (density * self._volumes[:, None, None] * self._mass).astype(np.float32)
            for a in range(3):
                elements[:, :, a, :, a] += scalar
        return elements.reshape(-1, self._rows, self._rows + self._own)

    def apply(self, elements: np.ndarray, own: sp.csr_matrix, fields: np.ndarray) -> np.ndarray:
        """Return the product with fields (n + s, m); ``own`` is the assembled matrix of the own functions."""
        at_nodes, at_surplus = fields[: self._unknowns], fields[self._unknowns :]
        image = np.concatenate([own @ at_nodes, np.zeros_like(at_surplus)])
        for block in self._blocks():
            mine, theirs = self._gathered(at_nodes, False, block), self._gathered(at_surplus, True, block)
            links, corner = elements[block, :, : self._own], elements[block, :, self._own :]
            image[: self._unknowns] += self._scattered(links.transpose(0, 2, 1) @ theirs, False, block)
            image[self._unknowns :] += self._scattered(links @ mine + corner @ theirs, True, block)
        return image

    def on_surplus(self, elements: np.ndarray, fields: np.ndarray) -> np.ndarray:
        """Return the product with fields (n, m) of the own functions, restricted to the surplus: (s, m)."""
        image = np.zeros((3 * self._counts[True], fields.shape[1]), dtype=fields.dtype)
        for block in self._blocks():
            product = elements[block, :, : self._own] @ self._gathered(fields, False, block)
            image += self._scattered(product, True, block)
        return image

    def inverse_diagonal(self, elements: np.ndarray):
        """Return a function that multiplies fields (s, m) by the inverse 3×3 diagonal blocks of the surplus."""
        rows = self._rows // 3
        corner = elements[:, :, self._own :].reshape(-1, rows, 3, rows, 3)
        blocks = np.zeros((self._counts[True], 3, 3))
        for row in range(rows):
            np.add.at(blocks, self._numbers[True][:, row], corner[:, row, :, row])
        inverse = np.linalg.inv(blocks).astype(np.float32)
        return lambda fields: (inverse @ fields.reshape(-1, 3, fields.shape[1])).reshape(fields.shape)

    def _blocks(self):
        for start in range(0, len(self._volumes), _BLOCK_ELEMENTS):
            yield slice(start, start + _BLOCK_ELEMENTS)

    def _gathered(self, fields: np.ndarray, surplus: bool, block: slice) -> np.ndarray:
        """Return the values (T, 3j, m) of fields (3c, m) in every element."""
        numbers = self._numbers[surplus][block]
        width = fields.shape[1]
        return fields.reshape(-1, 3 * width)[numbers].reshape(len(numbers), -1, width)

    def _scattered(self, parts: np.ndarray, surplus: bool, block: slice) -> np.ndarray:
        """Return the sums (3c, m) of element values (T, 3j, m)."""
        numbers = self._numbers[surplus][block].ravel()
        shape = self._counts[surplus], len(numbers)
        adding = sp.csr_matrix(
            (np.ones(len(numbers), parts.dtype), (numbers, np.arange(len(numbers)))), shape=shape
        )
        return (adding @ parts.reshape(len(numbers), -1)).reshape(-1, parts.shape[2])


def _reference_integrals(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean products of derivatives and of values over the reference element.

    They are the means of ``∂φ_r/∂L_p ∂φ_c/∂L_q`` (j (k + j), 16) and of ``φ_r φ_c`` (j, k + j), where r is in the
    surplus and L are the barycentric coordinates.
    """
    from skfem.quadrature import get_quadrature
    from skfem.refdom import RefTet

    places, weights = get_quadrature(RefTet, 2 * (order + 1))
    weights = weights / weights.sum()
    own, surplus = _functions(order, np.concatenate([1.0 - places.sum(axis=0, keepdims=True), places]))
    value, slope = (np.concatenate([o, s]) for o, s in zip(own, surplus, strict=True))
    stiff = np.einsum("rpx,cqx,x->rcpq", surplus[1], slope, weights)
    return stiff.reshape(-1, 16), np.einsum("rx,cx,x->rc", surplus[0], value, weights)


def _functions(order: int, at: np.ndarray):
    """Return values (k, x) and derivatives (k, 4, x) of own functions and surplus at barycentric points (4, x).

    The own functions are in scikit-fem's order. In the surplus, edges come before faces.
    """
    from skfem.refdom import RefTet

    corner, edge, cubic, face = [], [], [], []
    for a in range(4):
        corner.append((at[a], {a: 1.0}) if order == 1 else (at[a] * (2 * at[a] - 1), {a: 4 * at[a] - 1}))
    for a, b in RefTet.edges:
        edge.append((4 * at[a] * at[b], {a: 4 * at[b], b: 4 * at[a]}))
        # Its sign depends on the direction of the edge, so vertices must ascend in every element.
        slopes = {a: at[b] * (2 * at[a] - at[b]), b: at[a] * (at[a] - 2 * at[b])}
        cubic.append((at[a] * at[b] * (at[a] - at[b]), slopes))
    for a, b, c in RefTet.facets:
        face.append((at[a] * at[b] * at[c], {a: at[b] * at[c], b: at[a] * at[c], c: at[a] * at[b]}))

    def tabulated(functions):
        slopes = np.zeros((len(functions), *at.shape))
        for row, (_, given) in zip(slopes, functions, strict=True):
            for corner_, slope in given.items():
                row[corner_] = slope
        return np.array([value for value, _ in functions]), slopes

    parts = (corner, edge) if order == 1 else (corner + edge, cubic + face)
    return tuple(tabulated(part) for part in parts)
