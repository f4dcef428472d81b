"""Spline Ritz: displacements that are quadratic splines on a grid of cells, on any solid with a closed surface.

The box along the principal axes is cut into equal cells, nearly cubes. The scalar functions are products of uniform
quadratic B-splines, one for each group of 3 × 3 × 3 cells that the solid reaches into. A global polynomial must bend
everywhere to bend somewhere; a spline does not. So the same number of unknowns gives several times less error than
:mod:`vibraverse.learn.baselines.polynomials`, but where two parts of a body come closer than three cells, for splines
then hold them together. Höllig, Reif and Wipper (SIAM J. Numer. Anal. 39, 442, 2001) and Parvizian, Düster and Rank
(Comput. Mech. 41, 121, 2007) use such spaces for elements that need no mesh.

In a cell all functions are polynomials, so its matrices follow from the moments of the part of it inside the solid,

    m_abc = ∫ r^a s^b t^c dV,   a, b, c <= 4,   r, s, t from 0 to 1.

Parallel lines cross the solid along the shortest side of the box. Along a line the integral is exact, and across them
it is a sum. The splines' frequencies are upper bounds of those of that bundle of rods, which are the solid's within
some tenths of a percent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from vibraverse.contract.seeds import rng
from vibraverse.geometry.moments import principal_axes
from vibraverse.learn.baselines.galerkin import Clock, Spectrum, hertz
from vibraverse.physics.columns import orthonormalising
from vibraverse.physics.iterations import RIGID
from vibraverse.physics.materials import lame

#: Lines along the longest side of the box, at least.
LINES = 256
#: Cells along the longest side: at first, and at most.
_FIRST_CELLS, _MOST_CELLS = 2, 64
#: A function with less than this share of the mass of a whole one is left out.
_LEAST_MASS = 1e-8
#: Share by which the diagonal of the shifted stiffness is raised: functions that hardly reach the solid are dependent.
_RIDGE = 1e-11
#: Shift in the units of a normalised body, far below its first frequency's ω².
_SHIFT = 1e-2
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
    function i. ``cells`` are the cells along the axes.
    """

    mass: np.ndarray
    slopes: np.ndarray
    cells: tuple[int, int, int]

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
            matrix[a, :, a] += mu * trace + _SHIFT * self.mass
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
    """Return the splines of the solid in a closed surface (V, 3), (F, 3), about ``unknowns`` or fewer.

    Cells are made smaller until more splines would reach into the solid.
    """
    axes = principal_axes(vertices, faces)[1]
    axes = axes[:, np.argsort(-np.ptp((vertices @ axes)[np.unique(faces)], axis=0))]
    corners = vertices @ axes
    if np.linalg.det(axes) < 0:
        faces = faces[:, ::-1]
    used = corners[np.unique(faces)]
    low, sides = used.min(axis=0), np.ptp(used, axis=0)
    longest, best = _FIRST_CELLS, None
    while True:
        cells = np.maximum(1, np.ceil(sides / sides.max() * longest - 1e-9)).astype(int)
        moments = cell_moments((corners - low) / sides * cells, faces, cells)
        found = 3 * int(_reached(moments[..., 0, 0, 0] > 0).sum())
        if best is None or found <= unknowns:
            best = cells, moments
        if found >= 0.85 * unknowns or longest >= _MOST_CELLS:
            return _space(*best, sides / best[0])
        # The number of functions grows by at most the third power.
        longest = min(_MOST_CELLS, max(longest + 1, int(longest * np.cbrt(unknowns / found))))


def cell_moments(corners: np.ndarray, faces: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the moments (x, y, z, 5, 5, 5) of a solid's part in each cell, in units of the cell.

    ``corners`` (V, 3) are in cells, from 0 to ``cells`` (3,) along each axis.
    """
    per_cell = np.maximum(1, np.ceil(LINES / cells.max())).astype(int)
    shape = cells[:2] * per_cell
    line, height, sign = _crossings(corners * [per_cell, per_cell, 1], faces, shape)
    order = np.arange(1, 6)
    moments = np.zeros((shape.prod(), cells[2], 5))
    for level in range(cells[2]):
        inside = np.clip(height - level, 0.0, 1.0)
        reached = inside > 0
        powers = sign[reached, None] * inside[reached, None] ** order / order
        for power in range(5):
            moments[:, level, power] = np.bincount(line[reached], powers[:, power], len(moments))
    across = ((np.arange(per_cell) + 0.5) / per_cell)[:, None] ** np.arange(5) / per_cell
    moments = moments.reshape(cells[0], per_cell, cells[1], per_cell, cells[2], 5)
    moments = np.einsum("imjnkc,ma->ijnkac", moments, across, optimize=True)
    return np.einsum("ijnkac,nb->ijkabc", moments, across, optimize=True)


def _crossings(corners: np.ndarray, faces: np.ndarray, shape: np.ndarray):
    """Return where lines along z cross a surface: number of the line, height, and +1 where it leaves the solid.

    There is a line in the middle of every unit square of the plane; ``shape`` (2,) is their number along x and y.
    """
    a, b, c = (corners[faces[:, corner]] for corner in range(3))
    first = np.ceil(np.minimum(np.minimum(a, b), c)[:, :2] - 0.5).astype(int)
    last = np.floor(np.maximum(np.maximum(a, b), c)[:, :2] - 0.5).astype(int)
    count = np.maximum(last - first + 1, 0)
    both = count.prod(axis=1)
    face = np.repeat(np.arange(len(faces)), both)
    rank = np.arange(len(face)) - np.repeat(np.cumsum(both) - both, both)
    place = first[face] + np.stack(np.divmod(rank, np.maximum(count[face, 1], 1)), axis=1)
    u, v, at = b - a, c - a, place + 0.5 - a[face, :2]
    twice_area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    upright = twice_area == 0  # no line crosses it
    area = np.where(upright, 1.0, twice_area)[face]
    along = (at[:, 0] * v[face, 1] - at[:, 1] * v[face, 0]) / area
    across = (u[face, 0] * at[:, 1] - u[face, 1] * at[:, 0]) / area
    hit = (along >= 0) & (across >= 0) & (along + across <= 1) & ~upright[face]
    face, place = face[hit], place[hit]
    height = a[face, 2] + along[hit] * u[face, 2] + across[hit] * v[face, 2]
    return place[:, 0] * shape[1] + place[:, 1], height, np.sign(twice_area[face])


def _reached(occupied: np.ndarray) -> np.ndarray:
    """Return which functions (x + 2, y + 2, z + 2) reach into a cell with a part of the solid."""
    found = np.zeros(np.add(occupied.shape, 2), dtype=bool)
    for shift in np.ndindex(3, 3, 3):
        found[tuple(slice(s, s + n) for s, n in zip(shift, occupied.shape, strict=True))] |= occupied
    return found


def _space(cells: np.ndarray, moments: np.ndarray, sides: np.ndarray) -> SplineSpace:
    """Return the space from the moments in cells of these ``sides`` (3,)."""
    occupied = moments[..., 0, 0, 0] > 0
    reached = _reached(occupied)
    number = np.full(reached.shape, -1)
    number[reached] = np.arange(reached.sum())
    places = np.argwhere(occupied)[:, None] + np.array(list(np.ndindex(3, 3, 3)))
    functions = number[tuple(np.moveaxis(places, 2, 0))]
    inside, size = moments[occupied], int(reached.sum())
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
    return SplineSpace(mass[np.ix_(kept, kept)] * scale, slopes * scale, tuple(cells.tolist()))


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
        values.append(
            scipy.linalg.eigh(
                lam * k_lambda + mu * k_mu, eigvals_only=True, subset_by_index=(0, RIGID + count - 1)
            )
        )
    return np.array(values)[:, RIGID:]


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
    lowest = (0, RIGID + count + _GUARD - 1)
    turn = scipy.linalg.eigh(lam * k_lambda + mu * k_mu, subset_by_index=lowest)[1]
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
