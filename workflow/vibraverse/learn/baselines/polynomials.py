"""Polynomial Ritz: displacements that are polynomials in the coordinates, on any solid with a closed surface.

The scalar functions are products ``P_i(ξ) P_j(η) P_k(ζ)`` of Legendre polynomials with ``i + j + k <= N`` on the box
along the principal axes: 105, 252 or 495 unknowns for N = 4, 6 or 8. All matrices follow from the moments

    m_abc = ∫ P_a(ξ) P_b(η) P_c(ζ) dV,   a + b + c <= 2N,

because products and derivatives of Legendre polynomials are Legendre series with small coefficients. The divergence
theorem turns each moment into an integral over the surface, with ``∫ P_a = (P_{a+1} - P_{a-1}) / (2a + 1)``; quadrature
on the triangles is exact. So there is neither a mesh of the inside nor an error but that of the polynomials (and
rounding), and frequencies are upper bounds. The idea is that of resonant ultrasound spectroscopy (Visscher et al.,
J. Acoust. Soc. Am. 90, 2154, 1991), with Legendre products for conditioning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy.linalg
from numpy.polynomial.legendre import leggauss, legvander

from vibraverse.geometry.moments import principal_box
from vibraverse.geometry.surfaces import corners
from vibraverse.learn.baselines.galerkin import Clock, Spectrum, hertz
from vibraverse.physics.columns import lowest_pairs
from vibraverse.physics.materials import lame

#: Directions of the scalar functions whose weight is below this share of the largest are rounding errors.
_ROUNDING_SHARE = 1e-12
#: Quadrature points at once: tables that stay in the processor's cache are made twice as fast.
_BLOCK_POINTS = 6000


@dataclass(frozen=True)
class PolynomialSpace:
    """Polynomial displacements of one body, M-orthonormal and orthogonal to the rigid motions, for E = ρ = 1.

    ``k_lambda`` and ``k_mu`` (q, q) are the stiffness. ``coefficients`` (3s, q) belong to the Legendre products of
    ``powers`` (s, 3), components along the principal ``axes`` (columns), in coordinates ``(axesᵀ x - middle) / half``.
    """

    k_lambda: np.ndarray
    k_mu: np.ndarray
    coefficients: np.ndarray
    powers: np.ndarray
    axes: np.ndarray
    middle: np.ndarray
    half: np.ndarray

    def modes(self, poisson: float, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest ω² (m,) at a Poisson's ratio, and the modes as coefficients (q, m)."""
        if count > len(self.k_mu):
            raise ValueError(
                f"The polynomials have {len(self.k_mu)} elastic directions, too few for {count} modes; raise the degree"
            )
        lam, mu = lame(1.0, poisson)
        return lowest_pairs(lam * self.k_lambda + mu * self.k_mu, count)

    def fields(self, points: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return the displacements (3p, m) of coefficients (q, m) at points (p, 3), components interleaved."""
        degree = int(self.powers.max())
        tables = [legvander(x, degree) for x in ((points @ self.axes - self.middle) / self.half).T]
        scalars = np.prod(
            [table[:, power] for table, power in zip(tables, self.powers.T, strict=True)], axis=0
        )
        along = scalars @ (self.coefficients @ vectors).reshape(len(self.powers), -1)
        return (self.axes @ along.reshape(len(points), 3, -1)).reshape(3 * len(points), -1)


def exponents(degree: int) -> np.ndarray:
    """Return the degrees (s, 3) along the axes of all products up to a total degree."""
    return np.array([p for p in product(range(degree + 1), repeat=3) if sum(p) <= degree])


def polynomial_space(vertices: np.ndarray, faces: np.ndarray, degree: int) -> PolynomialSpace:
    """Return the polynomial displacements up to a total degree of the solid in a closed surface (V, 3), (F, 3)."""
    return polynomial_spaces(vertices, faces, [degree])[0]


def polynomial_spaces(
    vertices: np.ndarray, faces: np.ndarray, degrees: Sequence[int]
) -> list[PolynomialSpace]:
    """Return the spaces of several degrees; the moments, which take longest, are integrated once."""
    axes, low, high = principal_box(vertices, faces)
    middle, half = 0.5 * (high + low), 0.5 * (high - low)
    moments = legendre_moments((vertices @ axes - middle) / half, faces, 2 * max(degrees))
    return [_space(moments[(slice(2 * degree + 1),) * 3], degree, axes, middle, half) for degree in degrees]


def _space(moments: np.ndarray, degree: int, axes, middle, half) -> PolynomialSpace:
    """Return the space of a degree N from the moments (2N + 1, 2N + 1, 2N + 1); those above ``2N`` are not used."""
    powers = exponents(degree)
    gram = half.prod() * _gram(moments, powers)
    slopes = [_slope(powers, axis) / half[axis] for axis in range(3)]
    turn = _orthonormalising(gram)
    elastic = _elastic(turn.T @ gram @ _rigid(powers, middle, half).reshape(len(powers), -1))
    # Unknown (i, a) couples with (j, b) by D_ij^ab = ∫ ∂_a φ_i ∂_b φ_j, as in vibraverse.physics.elasticity.
    d = np.array([[turn.T @ first @ gram @ second.T @ turn for second in slopes] for first in slopes])
    trace = d[0, 0] + d[1, 1] + d[2, 2]
    k_lambda = _matrix(d)
    k_mu = _matrix(trace * np.eye(3)[:, :, None, None] + d.transpose(1, 0, 2, 3))
    return PolynomialSpace(
        k_lambda=elastic.T @ k_lambda @ elastic,
        k_mu=elastic.T @ k_mu @ elastic,
        coefficients=np.kron(turn, np.eye(3)) @ elastic,
        powers=powers,
        axes=axes,
        middle=middle,
        half=half,
    )


def polynomial_ritz(
    vertices: np.ndarray, faces: np.ndarray, material: dict, scale_m: float, degree: int = 8, modes: int = 64
) -> Spectrum:
    """Return the frequencies of the solid in a closed surface with polynomial displacements of a total degree.

    ``material`` holds ``young_pa``, ``density_kg_m3`` and ``poisson``; ``scale_m`` is metres per unit of the surface.
    """
    clock = Clock()
    with clock.part("matrices"):
        space = polynomial_space(vertices, faces, degree)
    with clock.part("ritz"):
        values, _ = space.modes(material["poisson"], modes)
    return Spectrum(hertz(values, material, scale_m), clock.seconds)


def legendre_moments(vertices: np.ndarray, faces: np.ndarray, degree: int) -> np.ndarray:
    """Return ``∫ P_a(x) P_b(y) P_c(z) dV`` of a solid in [-1, 1]³, as (d + 1, d + 1, d + 1) with d = ``degree``.

    Entries with ``a + b + c`` above the degree are zero.
    """
    places, weights = _triangle_rule(degree + 1)
    pairs = [(b, c) for b, c in product(range(degree + 1), repeat=2) if b + c <= degree]
    second, third = np.array(pairs).T
    flat = np.zeros((degree + 1, len(pairs)))
    odd = 2 * np.arange(1, degree + 1)[:, None] + 1
    block = max(1, _BLOCK_POINTS // len(weights))
    for start in range(0, len(faces), block):
        a, b, c = corners(vertices, faces[start : start + block])
        # The x-component of the normal times twice the area; the rule's weights sum to 1/2.
        normal = np.cross(b - a, c - a)[:, 0]
        points = np.einsum("qk,kfi->ifq", places, np.stack([a, b, c])).reshape(3, -1)
        x, y, z = (legvander(x, degree + 1).T for x in points)
        integral = np.concatenate([x[1:2], (x[2:] - x[:-2]) / odd])
        integral *= (normal[:, None] * weights).ravel()
        flat += integral @ (y[second] * z[third]).T
    moments = np.zeros((degree + 1,) * 3)
    moments[:, second, third] = flat
    first = np.arange(degree + 1)
    moments[first[:, None, None] + first[:, None] + first > degree] = 0.0
    return moments


def _triangle_rule(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a quadrature rule of a triangle that is exact for polynomials of a degree.

    It has barycentric points (q, 3) and weights (q,) of sum 1/2.
    """
    # Conical product: the square (u, v) is collapsed to (u, v (1 - u)), which adds a degree in u.
    count = degree // 2 + 1
    nodes, weights = leggauss(count + 1)
    u, wu = 0.5 * (nodes + 1), 0.5 * weights
    nodes, weights = leggauss(count)
    v, wv = 0.5 * (nodes + 1), 0.5 * weights
    first = np.repeat(u, len(v))
    other = np.tile(v, len(u)) * (1 - first)
    return np.stack([1 - first - other, first, other], axis=1), np.outer(wu * (1 - u), wv).ravel()


def _gram(moments: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Return the integrals (s, s) of products of the functions, by ``P_i P_l = Σ_a linear[i, l, a] P_a``."""
    degree = int(powers.max())
    nodes, weights = leggauss(2 * degree + 1)
    table = legvander(nodes, 2 * degree)
    linear = np.einsum("q,qi,ql,qa->ila", weights, table[:, : degree + 1], table[:, : degree + 1], table)
    linear *= np.arange(2 * degree + 1) + 0.5
    found = moments
    for _ in range(3):
        found = np.tensordot(found, linear, axes=(0, 2))  # the first axis becomes the last two
    first, second = powers.T[:, :, None], powers.T[:, None, :]
    return found[first[0], second[0], first[1], second[1], first[2], second[2]]


def _slope(powers: np.ndarray, axis: int) -> np.ndarray:
    """Return the matrix (s, s) that gives the derivatives of the functions along an axis of the cube."""
    # P_i' = Σ (2k + 1) P_k over k = i - 1, i - 3, …
    apart = powers[:, None, :] - powers[None, :, :]
    others = np.delete(apart, axis, axis=2)
    falls = (others == 0).all(axis=2) & (apart[:, :, axis] > 0) & (apart[:, :, axis] % 2 == 1)
    return falls * (2.0 * powers[None, :, axis] + 1.0)


def _rigid(powers: np.ndarray, middle: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return the coefficients (s, 3, 6) of the rigid motions."""
    rows = {tuple(power): row for row, power in enumerate(powers.tolist())}
    found = np.zeros((len(powers), 3, 6))
    constant = rows[0, 0, 0]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        found[constant, a, a] = 1.0
        for component, along, sign in ((b, c, -1.0), (c, b, 1.0)):
            linear = rows[tuple(int(along == axis) for axis in range(3))]
            found[linear, component, 3 + a] += sign * half[along]
            found[constant, component, 3 + a] += sign * middle[along]
    return found


def _elastic(rigid: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis (3r, 3r - 6) of all that is orthogonal to rigid coefficients (r, 18)."""
    columns = rigid.reshape(-1, 6)
    return scipy.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0][:, 6:]


def _orthonormalising(gram: np.ndarray) -> np.ndarray:
    """Return ``turn`` (s, r) with ``turnᵀ gram turn = I``, free of directions that are rounding errors."""
    weights, directions = scipy.linalg.eigh(gram)
    kept = weights > _ROUNDING_SHARE * weights[-1]
    turn = directions[:, kept] / np.sqrt(weights[kept])
    # The second pass removes the rounding errors of the first.
    root = scipy.linalg.cholesky(turn.T @ gram @ turn)
    return scipy.linalg.solve_triangular(root, turn.T, trans="T").T


def _matrix(blocks: np.ndarray) -> np.ndarray:
    """Return the symmetric matrix (3r, 3r) of blocks (3, 3, r, r): unknown ``3 i + a`` is component a of function i."""
    size = 3 * blocks.shape[2]
    matrix = blocks.transpose(2, 0, 3, 1).reshape(size, size)
    return 0.5 * (matrix + matrix.T)
