"""Spline Ritz: displacements that are quadratic splines on a grid of cells, on any solid with a closed surface.

The box along the principal axes is cut into equal cells, nearly cubes. The scalar functions are products of uniform
quadratic B-splines, one for each group of 3 × 3 × 3 cells that the solid reaches into. A global polynomial must bend
everywhere to bend somewhere; a spline does not. So more unknowns go on helping, where those of
:mod:`vibraverse.learn.baselines.polynomials` become dependent. Where the solid within a spline's reach falls into
pieces, as between the prongs of a fork or the walls around a flat cavity, each piece gets a spline of its own. Höllig,
Reif and Wipper (SIAM J. Numer. Anal. 39, 442, 2001) and Parvizian, Düster and Rank (Comput. Mech. 41, 121, 2007) use
such spaces for elements that need no mesh.

In a cell all functions are polynomials, so matrices follow from moments of the solid's parts in it
(:mod:`vibraverse.learn.baselines.rods`). The frequencies are upper bounds of those of a bundle of rods that stands for
the solid, which are the solid's within some tenths of a percent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from vibraverse.contract.seeds import rng
from vibraverse.geometry.moments import principal_box
from vibraverse.learn.baselines.galerkin import Clock, Spectrum, hertz
from vibraverse.learn.baselines.rods import Rods, cut_rods, groups
from vibraverse.physics.columns import lowest_pairs, orthonormalising
from vibraverse.physics.iterations import RIGID
from vibraverse.physics.materials import lame

#: Cells along the longest side: at first, and at most.
_FIRST_CELLS, _MOST_CELLS = 2, 64
#: A function with less than this share of the mass of a whole one is left out.
_LEAST_MASS = 1e-8
#: Share by which the diagonal of the shifted stiffness is raised: functions that hardly reach the solid are dependent.
_RIDGE = 1e-11
#: Shift over the square of the longest side, far below the first frequency's ω².
_SHIFT = 0.03
#: Vectors of a Krylov block and blocks.
_BLOCK, _BLOCKS = 48, 5
#: Vectors besides the modes asked for that are improved at a second Poisson's ratio.
_GUARD = 12
#: Coefficients in 1, t, t² of the three quadratic B-splines that live in a cell, and of their derivatives.
_VALUES = np.array([[0.5, -1.0, 0.5], [0.5, 1.0, -1.0], [0.0, 0.0, 0.5]])
_SLOPES = np.array([[-1.0, 1.0, 0.0], [1.0, -2.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class SplineSpace:
    """Matrices of the splines of one body for E = ρ = 1, dense, each function scaled to unit mass.

    ``mass`` (s, s), and ``slopes`` (3, 3, s, s) with ``∫ ∂_a φ_i ∂_b φ_j``. Unknown ``a s + i`` is component a of
    function i. ``cells`` are the cells along the axes, ``longest`` is the longest side of the box.
    """

    mass: np.ndarray
    slopes: np.ndarray
    cells: tuple[int, int, int]
    longest: float

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return 3 * len(self.mass)

    def weighted(self, vectors: np.ndarray) -> np.ndarray:
        """Return the mass matrix times vectors (3s, k)."""
        return (self.mass @ vectors.reshape(3, len(self.mass), -1)).reshape(vectors.shape)

    def shifted(self, poisson: float) -> np.ndarray:
        """Return stiffness plus shifted mass (3s, 3s) at a Poisson's ratio."""
        lam, mu = lame(1.0, poisson)
        size, trace = len(self.mass), np.einsum("aaij->ij", self.slopes)
        matrix = np.empty((3, size, 3, size))
        for a in range(3):
            for b in range(3):
                matrix[a, :, b] = lam * self.slopes[a, b] + mu * self.slopes[b, a]
            matrix[a, :, a] += mu * trace + _SHIFT / self.longest**2 * self.mass
        matrix = matrix.reshape(3 * size, 3 * size)
        matrix[np.diag_indices(3 * size)] *= 1.0 + _RIDGE
        return matrix

    def projected(self, space: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the stiffness in the span of vectors (3s, q), as its parts (q, q) of λ and of μ."""
        parts, trace = space.reshape(3, len(self.mass), -1), np.einsum("aaij->ij", self.slopes)
        k_lambda = sum(parts[a].T @ sum(self.slopes[a, b] @ parts[b] for b in range(3)) for a in range(3))
        k_mu = sum(
            parts[a].T @ (trace @ parts[a] + sum(self.slopes[b, a] @ parts[b] for b in range(3)))
            for a in range(3)
        )
        return 0.5 * (k_lambda + k_lambda.T), 0.5 * (k_mu + k_mu.T)


def spline_ritz(
    vertices: np.ndarray,
    faces: np.ndarray,
    material: dict,
    scale_m: float,
    unknowns: int = 3000,
    modes: int = 64,
) -> Spectrum:
    """Return the frequencies of the solid in a closed surface with splines of about so many unknowns.

    ``material`` holds ``young_pa``, ``density_kg_m3`` and ``poisson``; ``scale_m`` is metres per unit of the surface.
    """
    clock = Clock()
    with clock.part("matrices"):
        space = spline_space(vertices, faces, unknowns)
    with clock.part("ritz"):
        values = spline_modes(space, [material["poisson"]], modes)[0]
    return Spectrum(hertz(values, material, scale_m), clock.seconds)


def spline_space(vertices: np.ndarray, faces: np.ndarray, unknowns: int) -> SplineSpace:
    """Return the splines of the solid in a closed surface (V, 3), (F, 3), about ``unknowns`` of them.

    Cells are made smaller until more splines would reach into the solid. Raises :class:`ValueError` for one too thin.
    """
    axes, low, high = principal_box(vertices, faces)
    longest_first = np.argsort(low - high)
    axes, low, sides = axes[:, longest_first], low[longest_first], (high - low)[longest_first]
    corners = vertices @ axes
    if np.linalg.det(axes) < 0:
        faces = faces[:, ::-1]
    longest, best = _FIRST_CELLS, None
    while True:
        cells = np.maximum(1, np.ceil(sides / sides.max() * longest - 1e-9)).astype(int)
        width, _, height = sides / cells
        rods = cut_rods((corners - low) / sides * cells, faces, cells, width / height)
        found = 3 * int(_reached(rods.cell, cells).sum())
        if not found:
            raise ValueError("The solid is so thin that no line of a rod meets it; give a thicker one")
        if best is None or found <= unknowns:
            best = rods, cells
        if found >= 0.85 * unknowns or longest >= _MOST_CELLS:
            return _space(*best, sides / best[1])
        # The number of functions grows by at most the third power.
        longest = min(_MOST_CELLS, max(longest + 1, int(longest * np.cbrt(unknowns / found))))


def _reached(cell: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return which functions (x + 2, y + 2, z + 2) reach into one of the cells (n, 3)."""
    occupied = np.zeros(cells, dtype=bool)
    occupied[tuple(cell.T)] = True
    found = np.zeros(cells + 2, dtype=bool)
    for shift in np.ndindex(3, 3, 3):
        found[tuple(slice(s, s + n) for s, n in zip(shift, cells, strict=True))] |= occupied
    return found


def _space(rods: Rods, cells: np.ndarray, sides: np.ndarray) -> SplineSpace:
    """Return the space of rods in cells of these ``sides`` (3,)."""
    rods = rods.in_one_piece()
    part, adjacent = rods.parts()
    functions = _functions(rods.cells_of(part), adjacent)
    inside, size = rods.moments(part), int(functions.max()) + 1
    flat = functions[:, :, None] * size + functions[:, None, :]

    def assembled(left: tuple[int, ...], right: tuple[int, ...]) -> np.ndarray:
        """Return the integrals (s, s) of products of functions, or of their derivatives along an axis."""
        found = inside
        for axis in range(3):
            found = np.tensordot(found, _products(left[axis], right[axis]), axes=(1, 2))
        local = found.transpose(0, 1, 3, 5, 2, 4, 6).reshape(len(inside), 27, 27)
        scale = sides.prod() / np.prod(sides ** (np.array(left) + right))
        return scale * np.bincount(flat.ravel(), local.ravel(), size * size).reshape(size, size)

    none, unit = (0, 0, 0), np.eye(3, dtype=int)
    mass = assembled(none, none)
    whole = sides.prod() * (_products(0, 0)[1, 1] @ (1.0 / np.arange(1, 6))) ** 3
    kept = np.flatnonzero(np.diag(mass) > _LEAST_MASS * whole)
    scale = 1.0 / np.sqrt(np.diag(mass)[kept])
    slopes = np.empty((3, 3, len(kept), len(kept)))
    for a in range(3):
        for b in range(a, 3):
            slopes[a, b] = assembled(tuple(unit[a]), tuple(unit[b]))[np.ix_(kept, kept)]
            slopes[b, a] = slopes[a, b].T
    scale = scale[:, None] * scale
    longest = float((sides * cells).max())
    return SplineSpace(mass[np.ix_(kept, kept)] * scale, slopes * scale, tuple(cells.tolist()), longest)


def _functions(cell: np.ndarray, adjacent: np.ndarray) -> np.ndarray:
    """Return the numbers (p, 27) of the functions in each part of a cell; ``cell`` (p, 3), ``adjacent`` (k, 2).

    The parts within reach of a spline may hang together or not. Each group that does gets a function of its own.
    """
    offsets = np.array(list(np.ndindex(3, 3, 3)))
    number = np.arange(27).reshape(3, 3, 3)
    first, second = adjacent.T
    axis = np.abs(cell[second] - cell[first]).argmax(axis=1)
    links = []
    for along in range(3):
        here = offsets[offsets[:, along] > 0]
        there = here - np.eye(3, dtype=int)[along]
        one, other = (number[tuple(some.T)] for some in (here, there))
        chosen = axis == along
        links.append([
            (27 * first[chosen, None] + one).ravel(), (27 * second[chosen, None] + other).ravel()
        ])  # fmt: skip
    return groups(27 * len(cell), *np.concatenate(links, axis=1)).reshape(-1, 27)


def _products(left: int, right: int) -> np.ndarray:
    """Return the coefficients (3, 3, 5) in 1, t, … t⁴ of products of splines (0) or of their derivatives (1)."""
    first, second = (_SLOPES if one else _VALUES for one in (left, right))
    return np.array([[np.convolve(one, other) for other in second] for one in first])


def spline_modes(space: SplineSpace, poisson, count: int) -> np.ndarray:
    """Return the lowest ω² (k, m) of the elastic modes at Poisson's ratios (k,) between two of them, for E = ρ = 1.

    A block Krylov space at one ratio holds the modes; where several ratios are asked for, the modes there are improved
    at a second one. Raises :class:`ValueError` for more modes than the splines have.
    """
    low, high = min(poisson), max(poisson)
    first, second = low + 0.2 * (high - low), low + 0.8 * (high - low)
    if space.unknowns <= 2 * _BLOCK * _BLOCKS:
        found = np.kron(np.eye(3), orthonormalising(space.mass, _LEAST_MASS)[0])  # all there is
    else:
        found = _krylov(space, first)
        if high > low:
            found = np.hstack([found, _improved(space, found, second, count)])
    if found.shape[1] < RIGID + count:
        raise ValueError(f"{space.unknowns} unknowns are too few for {count} modes; ask for more")
    k_lambda, k_mu = space.projected(found)
    values = []
    for ratio in poisson:
        lam, mu = lame(1.0, ratio)
        all_values = scipy.linalg.eigvalsh(lam * k_lambda + mu * k_mu, driver="evd")
        values.append(all_values[RIGID : RIGID + count])
    return np.array(values)


def _krylov(space: SplineSpace, poisson: float) -> np.ndarray:
    """Return M-orthonormal vectors (3s, q) that hold the lowest modes at a Poisson's ratio."""
    inverse = _inverse(space, poisson)
    block = rng("splines").standard_normal((space.unknowns, _BLOCK))
    found = np.empty((space.unknowns, 0))
    for _ in range(_BLOCKS):
        block = _apart(space, found, inverse(block))
        found = np.hstack([found, block])
    return found


def _improved(space: SplineSpace, found: np.ndarray, poisson: float, count: int) -> np.ndarray:
    """Return M-orthonormal vectors that, beside those found at another Poisson's ratio, hold the modes at this one."""
    lam, mu = lame(1.0, poisson)
    k_lambda, k_mu = space.projected(found)
    turn = lowest_pairs(lam * k_lambda + mu * k_mu, RIGID + count + _GUARD)[1]
    return _apart(space, found, _inverse(space, poisson)(found @ turn))


def _inverse(space: SplineSpace, poisson: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that multiplies vectors (3s, k) by the mass and divides by the shifted stiffness."""
    matrix = space.shifted(poisson)
    factor = scipy.linalg.cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)
    return lambda vectors: scipy.linalg.cho_solve(factor, space.weighted(vectors), check_finite=False)


def _apart(space: SplineSpace, known: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return an M-orthonormal basis of what ``block`` (3s, k) adds to M-orthonormal vectors (3s, q)."""
    for _ in range(2):  # the second pass removes the rounding errors of the first
        block = block - known @ (known.T @ space.weighted(block))
        block = block @ orthonormalising(block.T @ space.weighted(block), 1e-12)[0]
    return block
