"""A small space of displacements in which the eigenproblem is solved for every Poisson's ratio.

``Reduction`` holds the space, free of rigid motions, and the operators projected onto an M-orthonormal basis of it. The
basis is stored only as a small matrix of coefficients in the vectors that joined the space, which saves several passes
over these. The space grows by corrections: if the Ritz pair ``(ω², u)`` at some ν has the residual
``r = K(ν) u - ω² M u``, the vector ``B⁻¹ r`` joins the space. ``B = K(ν₀) - σM`` is a fixed, factorised matrix,
spectrally equivalent to ``K(ν) - σM`` within the factor ``(1 - 2ν₀) / (1 - 2ν)``. So near ν₀ a correction costs one
solve per mode, whereas a new solution at ν would cost four and a factorisation.

Errors must be known before they are corrected, and later for every material. To first order the relative error of a
frequency is ``rᵀ B⁻¹ r / 2ω²``, up to the factor in :func:`vibraverse.physics.reduced.solve_reduced`. That norm is
estimated from random vectors ``y`` with covariance B⁻¹, each of which costs half a solve: ``E (yᵀ r)² = rᵀ B⁻¹ r``. The
residual is linear in ``W = [K_λ U, K_μ U, M U]``, so an estimate needs only the small matrix ``Yᵀ W``. With p vectors
its relative standard deviation is ``sqrt(2/p)``. (Residual-based randomised estimators: Smetana, Zahm and Patera, SIAM
J. Sci. Comput. 41, A900, 2019.)
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from vibraverse.physics.columns import (
    Columns,
    combine,
    orthonormalise,
    orthonormalising,
    product,
    project_out,
)
from vibraverse.physics.elasticity import Operators, rigid_modes
from vibraverse.physics.materials import lame
from vibraverse.physics.reduced import solve_reduced

#: Number of random vectors per estimate.
_SKETCH_VECTORS = 48
#: Initial capacity in multiples of the modes with which the space starts.
_CAPACITY_FACTOR = 8
#: If the part of joining vectors outside the space, or any direction of it, has less than the first share of their
#: squares, rounding matters; then that part is formed and orthogonalised again. Directions with less than the second
#: share are left out.
_CANCELLATION, _ROUNDING_SHARE = 1e-6, 1e-14
#: Directions of a correction that lower the error by less than this share of the wanted error are left out.
_MIN_GAIN = 0.01


class Reduction:
    """A space with an M-orthonormal basis of r vectors, and ``a_lambda``, ``a_mu`` (r, r) projected onto it.

    ``vectors`` (n, q) span the space, q ≥ r. The displacement with coefficients c in the basis is
    ``vectors @ in_vectors(c)``. :meth:`use` sets the factorisation for the corrections that follow.
    """

    def __init__(self, operators: Operators, vectors: np.ndarray):
        self._operators, self._factor, self._shift = operators, None, 0.0
        self._rigid, self._weighted_rigid, _ = orthonormalise(rigid_modes(operators.nodes), operators.mass)
        n = operators.unknowns
        self._columns = Columns(n, _CAPACITY_FACTOR * vectors.shape[1])
        self._turn = np.zeros((0, 0))
        self._projected = [np.zeros((0, 0)) for _ in range(2)]
        # Random vectors times K_λ, K_μ and M.
        self._probes: list[list[np.ndarray]] = []
        self._sketches: list[np.ndarray] = []
        self._energy_poisson: list[float] = []
        self.join(vectors)

    @property
    def vectors(self) -> np.ndarray:
        """The vectors that span the space, (n, q)."""
        return self._columns.all

    def in_vectors(self, coefficients: np.ndarray) -> np.ndarray:
        """Return coefficients (q, m) in :attr:`vectors` from coefficients (r, m) in the basis."""
        return self._turn @ coefficients

    @property
    def a_lambda(self) -> np.ndarray:
        """``K_λ`` projected onto the basis, (r, r)."""
        return self._projected[0]

    @property
    def a_mu(self) -> np.ndarray:
        """``K_μ`` projected onto the basis, (r, r)."""
        return self._projected[1]

    @property
    def energy_poisson(self) -> np.ndarray:
        """Every ν₀ used so far, (k,)."""
        return np.array(self._energy_poisson)

    def use(self, factor, poisson: float, shift: float, rng: np.random.Generator) -> None:
        """Use a factorisation of ``K(poisson) - shift M`` for corrections and for error estimates near ``poisson``."""
        self._factor, self._shift = factor, shift
        self._energy_poisson.append(poisson)
        probes = factor.inverse_root(rng.standard_normal((self._operators.unknowns, _SKETCH_VECTORS)))
        operators = self._operators
        self._probes.append(
            [product(matrix, probes) for matrix in (operators.k_lambda, operators.k_mu, operators.mass)]
        )
        self._sketches.append(_sketched(self._probes[-1], self.vectors) @ self._turn)

    def solve(self, poisson: float, modes: int, guard: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the result of :func:`solve_reduced` in the space."""
        sketch = _flat(np.stack(self._sketches))
        return solve_reduced(self.a_lambda, self.a_mu, sketch, self.energy_poisson, poisson, modes, guard)

    def correct(self, poisson: float, values: np.ndarray, coefficients: np.ndarray, max_error: float) -> None:
        """Extend the space by the corrections of Ritz pairs (m,), (r, m) at a Poisson's ratio."""
        stiffness = self._operators.stiffness(*lame(1.0, poisson))
        modes = np.ascontiguousarray(combine(self.vectors, self.in_vectors(coefficients)))
        residual = stiffness @ modes
        residual -= values * (self._operators.mass @ modes)
        # Scaled so that xᵀ B x is the square of the relative error. Directions that hardly lower it are left out.
        residual = np.asfortranarray(residual / np.sqrt(values))
        correction = self._factor.solve(residual)
        energy = correction.T @ residual
        gain, turn = np.linalg.eigh(0.5 * (energy + energy.T))
        kept = gain > _MIN_GAIN * max_error
        if not kept.all():
            correction, residual = (combine(block, turn[:, kept]) for block in (correction, residual))
        self.join(correction, residual)

    def needed(self, coefficients: np.ndarray, drop: float) -> np.ndarray:
        """Return an orthonormal basis (r, s) of the directions that Ritz vectors (r, m) need by more than ``drop``.

        Directions are measured by their energy, which determines the error of a frequency.
        """
        energy = np.linalg.cholesky(self._projected[0] + self._projected[1])
        scaled = energy.T @ coefficients
        scaled /= np.linalg.norm(scaled, axis=0)
        weights, directions = np.linalg.eigh(scaled @ scaled.T)
        directions = directions[:, weights > drop**2 * weights[-1]][:, ::-1]
        return np.linalg.qr(scipy.linalg.solve_triangular(energy.T, directions))[0]

    def turned(self, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``a_lambda``, ``a_mu`` and ``sketch`` of a subspace whose basis has coefficients ``turn`` (r, s)."""
        a_lambda, a_mu = (turn.T @ matrix @ turn for matrix in self._projected)
        return 0.5 * (a_lambda + a_lambda.T), 0.5 * (a_mu + a_mu.T), _flat(np.stack(self._sketches) @ turn)

    def join(self, block: np.ndarray, image: np.ndarray | None = None) -> None:
        """Add the span of ``block`` (n, k) to the space; ``image`` is ``B block`` if known.

        Then ``K(ν₀) block`` is known too, which saves one of two products with a stiffness matrix.
        """
        old, operators = self.vectors, self._operators
        block = np.array(block, order="F")
        for last in (False, False, True):
            project_out(block, self._rigid, self._weighted_rigid)
            rows = np.ascontiguousarray(block)  # as sparse products need them
            weighted = operators.mass @ rows
            gram, within = block.T @ weighted, self._turn.T @ (old.T @ weighted)
            outside = gram - within.T @ within
            share = (np.diag(outside) / np.diag(gram)).min()
            turn, least = orthonormalising(outside, _ROUNDING_SHARE)
            if share * least > _CANCELLATION or last:
                break
            image = None
            block -= combine(old, self.in_vectors(within))
            if share > _CANCELLATION:  # otherwise the turn is itself a rounding error
                block = combine(block, turn)
        sides = [self._sides(operators.k_lambda @ rows, block)]
        if image is None:
            sides.append(self._sides(operators.k_mu @ rows, block))
        else:
            lam, mu = lame(1.0, self._energy_poisson[-1])
            known = zip(self._sides(image, block), (within, gram), sides[0], strict=True)
            sides.append(tuple((side + self._shift * mass - lam * other) / mu for side, mass, other in known))
        self._projected = [
            _grown(projected, *side, within, turn)
            for projected, side in zip(self._projected, sides, strict=True)
        ]
        self._sketches = [
            np.concatenate([sketch, (_sketched(probes, block) - sketch @ within) @ turn], axis=-1)
            for sketch, probes in zip(self._sketches, self._probes, strict=True)
        ]
        self._columns.append(block)
        beside = -self._turn @ within @ turn
        self._turn = np.block([[self._turn, beside], [np.zeros((len(turn), self._turn.shape[1])), turn]])

    def _sides(self, image: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the products of an image (n, k) with the basis (r, k) and with ``block`` (k, k)."""
        return self._turn.T @ (self.vectors.T @ image), block.T @ image


def _sketched(probes: list[np.ndarray], vectors: np.ndarray) -> np.ndarray:
    """Return the products (p, 3, r) of three images (n, p) of random vectors with ``vectors`` (n, r)."""
    return np.stack([image.T @ vectors for image in probes], axis=1)


def _flat(sketch: np.ndarray) -> np.ndarray:
    """Return sketches (k, p, 3, r) as (k, p, 3r)."""
    return sketch.reshape(*sketch.shape[:2], -1)


def _grown(
    projected: np.ndarray, side: np.ndarray, corner: np.ndarray, within: np.ndarray, turn: np.ndarray
) -> np.ndarray:
    """Return a projected matrix (r, r) extended from the basis Q by the vectors ``(C - Q within) turn``.

    ``side`` is its projection onto Q and C, ``corner`` its projection onto C.
    """
    across = side - projected @ within
    corner = corner - within.T @ across - side.T @ within
    across, corner = across @ turn, turn.T @ corner @ turn
    return np.block([[projected, across], [across.T, 0.5 * (corner + corner.T)]])
