"""Frequencies of free elastic bodies without finite elements, as references for the solver.

Balls and spherical shells have characteristic equations in spherical Bessel functions (H. Lamb, Proc. London Math.
Soc. s1-13, 189, 1881; A. C. Eringen and E. S. Şuhubi, Elastodynamics II, 1975, ch. 8). Other simple bodies are solved
by Ritz's method with polynomials over the whole body (H. H. Demarest, J. Acoust. Soc. Am. 49, 768, 1971; W. M.
Visscher et al., J. Acoust. Soc. Am. 90, 2154, 1991). It converges faster than any power of the degree for smooth modes.
Only Lamé's parameters are shared with the finite elements.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import product

import numpy as np

from vibraverse.physics.materials import lame

#: Steps of ω a / c_s in which a determinant is scanned for changes of sign.
_SCAN_STEP = 2e-3
#: Points and their weights (Q,).
Quadrature = tuple[np.ndarray, np.ndarray]


def spherical(poisson: float, limit: float, cavity: float = 0.0) -> dict[str, float]:
    """Return ``ω a / c_s`` of a free ball of radius a, or of the shell left by a cavity of radius ``cavity * a``.

    These are all multiplets up to ``limit``, ascending, by name: ``T2`` is the first toroidal one of degree 2, ``S0'``
    the second spheroidal one of degree 0. A multiplet of degree n has 2n + 1 equal frequencies. ``c_s`` is the speed of
    shear waves.
    """
    radii = np.array([1.0, cavity] if cavity else [1.0])
    slowness = np.sqrt((1 - 2 * poisson) / (2 - 2 * poisson))  # of pressure waves relative to shear waves
    found, degree = {}, 0
    while degree <= 2 or any(name[1:].startswith(str(degree - 1)) for name in found):
        kinds = {"S": partial(_spheroidal, degree, radii, slowness)}
        if degree:
            kinds["T"] = partial(_toroidal, degree, radii)
        for kind, tractions in kinds.items():
            for overtone, root in enumerate(_roots(tractions, limit)):
                found[f"{kind}{degree}" + "'" * overtone] = root
        degree += 1  # the lowest frequency rises with the degree from 2 on
    return dict(sorted(found.items(), key=lambda item: item[1]))


def _roots(tractions: Callable[[np.ndarray], np.ndarray], limit: float) -> list[float]:
    """Return the ω a / c_s at which the matrix of boundary tractions is singular."""
    from scipy.optimize import brentq

    def determinant(eta):
        matrices = tractions(np.atleast_1d(eta))
        return np.linalg.det(matrices / np.abs(matrices).max(axis=1, keepdims=True))

    grid = np.append(np.arange(_SCAN_STEP, limit, _SCAN_STEP), limit)
    signs = np.sign(determinant(grid))
    return [
        brentq(lambda eta: determinant(eta)[0], grid[i], grid[i + 1], xtol=1e-13)
        for i in np.flatnonzero(signs[1:] != signs[:-1])
    ]


def _waves(n: int, x: np.ndarray, cavity: bool) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return ``z_n(x)`` and ``x z_{n+1}(x)`` of every wave; those singular at the centre exist only with a cavity."""
    from scipy.special import spherical_jn, spherical_yn

    return [(z(n, x), x * z(n + 1, x)) for z in ([spherical_jn, spherical_yn] if cavity else [spherical_jn])]


def _toroidal(n: int, radii: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Return the tractions (E, R, R) of toroidal waves (columns) at the radii (rows) for ``eta`` (E,)."""
    rows = [[(n - 1) * z - xz for z, xz in _waves(n, eta * radius, len(radii) > 1)] for radius in radii]
    return np.moveaxis(np.array(rows), -1, 0)


def _spheroidal(n: int, radii: np.ndarray, slowness: float, eta: np.ndarray) -> np.ndarray:
    """Return the tractions of pressure and shear waves (columns), radial and tangential at every radius (rows).

    Degree 0 has neither a shear wave nor a tangential traction.
    """
    rows = []
    for radius in radii:
        half = 0.5 * (eta * radius) ** 2
        pressure = _waves(n, slowness * eta * radius, len(radii) > 1)
        shear = _waves(n, eta * radius, len(radii) > 1) if n else []
        rows.append(
            [(n * n - n - half) * z + 2 * xz for z, xz in pressure]
            + [n * (n + 1) * ((n - 1) * z - xz) for z, xz in shear]
        )
        if n:
            rows.append(
                [(n - 1) * z - xz for z, xz in pressure] + [(n * n - 1 - half) * z + xz for z, xz in shear]
            )
    return np.moveaxis(np.array(rows), -1, 0)


def ritz(
    inside: Quadrature, half_sides, degrees: tuple[int, int, int], poisson: float, modes: int
) -> np.ndarray:
    """Return the lowest ω (modes,) of a free body for E = ρ = 1 by Ritz's method, as upper bounds.

    The polynomials are the products of Legendre polynomials with ``Σ k_a / degrees_a <= 1``. ``inside`` integrates
    products of two over the octant of positive coordinates. The body fits into the box of ``half_sides`` about the
    origin and is symmetric in the three coordinate planes, so the problem splits into eight.
    """
    import scipy.linalg

    points, weights = inside
    tables = [_legendre(points[:, a] / half_sides[a], degrees[a]) for a in range(3)]
    powers = np.array(list(product(*(range(degree + 1) for degree in degrees))))
    powers = powers[(powers / degrees).sum(axis=1) <= 1 + 1e-9]
    lam, mu = lame(1.0, poisson)
    squares = []
    for mirror in product((0, 1), repeat=3):
        # Component a is odd along axis a if the others are even.
        chosen = [
            powers[(powers % 2 == np.array(mirror) ^ (np.arange(3) == a)).all(axis=1)] for a in range(3)
        ]
        values = [_products(tables, some, half_sides) for some in chosen]
        gradients = [[_products(tables, some, half_sides, b) for b in range(3)] for some in chosen]

        def integral(one, other):
            return one.T @ (weights[:, None] * other)

        stiffness = [
            [
                lam * integral(gradients[a][a], gradients[b][b])
                + mu * integral(gradients[a][b], gradients[b][a])
                for b in range(3)
            ]
            for a in range(3)
        ]
        for a in range(3):
            stiffness[a][a] = stiffness[a][a] + mu * sum(integral(slope, slope) for slope in gradients[a])
        mass = scipy.linalg.block_diag(*(integral(value, value) for value in values))
        squares.append(scipy.linalg.eigh(np.block(stiffness), mass, eigvals_only=True))
    return np.sqrt(np.sort(np.concatenate(squares))[6 : modes + 6])


def _products(tables, powers: np.ndarray, half_sides, derived: int | None = None) -> np.ndarray:
    """Return products of polynomials (Q, n), or their derivatives along an axis."""
    factors = [table[int(a == derived)][:, powers[:, a]] for a, table in enumerate(tables)]
    return np.prod(factors, axis=0) / (1.0 if derived is None else half_sides[derived])


def _legendre(x: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return Legendre polynomials up to a degree at ``x`` (Q,), and their derivatives, both (Q, degree + 1)."""
    from numpy.polynomial import legendre

    derived = legendre.legder(np.eye(degree + 1))
    return legendre.legvander(x, degree), legendre.legvander(x, max(degree - 1, 0)) @ derived


def box(sides, degrees: tuple[int, int, int], poisson: float, modes: int) -> np.ndarray:
    """Return ω (modes,) of a free box for E = ρ = 1, by :func:`ritz`."""
    half = np.asarray(sides, dtype=float) / 2
    axes = [_gauss(degree + 1) for degree in degrees]
    points = np.stack(np.meshgrid(*(x for x, _ in axes), indexing="ij"), axis=-1).reshape(-1, 3)
    weights = np.prod(np.meshgrid(*(w for _, w in axes), indexing="ij"), axis=0).ravel()
    return ritz((points * half, weights * half.prod()), half, degrees, poisson, modes)


def cylinder(radius: float, height: float, degree: int, poisson: float, modes: int) -> np.ndarray:
    """Return ω (modes,) of a free cylinder for E = ρ = 1, by :func:`ritz`."""
    t, w = _gauss(degree + 1)  # for the squared radius and for z; equally spaced angles are exact
    angles = (np.arange(degree + 1) + 0.5) * np.pi / (2 * degree + 2)
    r, angle, z = (x.ravel() for x in np.meshgrid(np.sqrt(t), angles, t, indexing="ij"))
    points = np.stack([radius * r * np.cos(angle), radius * r * np.sin(angle), height / 2 * z], axis=1)
    weights = (w[:, None, None] * (0.5 * np.pi / (2 * degree + 2)) * w * np.ones((degree + 1, 1))).ravel()
    half_sides = np.array([radius, radius, height / 2])
    return ritz((points, weights * radius**2 * height / 2), half_sides, (degree,) * 3, poisson, modes)


def _gauss(count: int) -> Quadrature:
    """Return Gauss points and weights on [0, 1], exact to the degree ``2 count - 1``."""
    x, w = np.polynomial.legendre.leggauss(count)
    return (1 + x) / 2, w / 2
