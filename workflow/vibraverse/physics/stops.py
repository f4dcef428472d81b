"""A body at many Poisson's ratios, small enough for a web page: exact frequencies, and mode shapes in few columns.

Everything but Poisson's ratio scales exactly, so a page that lets one choose a material needs frequencies at a row of
*stops* of ``ν``, and the shapes. Mode shapes of all ``ν`` span few dimensions. A singular value decomposition of those
at some ``ν``, the *nodes*, in the mass norm gives ``k`` columns; each node keeps a matrix (m, k) that makes its modes
from them. Between nodes the page takes the shapes of the nearest one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.physics.modes import ReducedModes, reduced_solve
from vibraverse.physics.reduced import ModalBasis

#: Distance of the stops, and their digits.
STEP, DIGITS = 0.01, 2
#: Nodes, unless more are named.
NODES = 13
#: How much more than other nodes the named ones weigh in the choice of columns.
_NAMED_WEIGHT = 4.0
#: Smallest singular value of a column, relative to the largest; what lies below is rounding, at any length.
_SMALLEST = 1e-4
#: Smallest eigenvalue of the mass matrix, relative to the largest.
_SMALLEST_MASS = 1e-12


@dataclass(frozen=True)
class Stops:
    """A body at many Poisson's ratios, for E = ρ = 1 in mesh units.

    - ``poisson`` (n,), ascending, and the ``angular`` frequencies ``ω̂`` (n, m).
    - ``nodes`` (j,): the Poisson's ratios whose shapes are kept, ascending and among the stops.
    - ``columns`` (r, k), or (r + c, k) with corrections: coefficients of the shape columns in the modal basis.
    - ``rotations`` (j, m, k): the coefficients of each node's modes in the columns.
    - ``solved``: the modes at every stop.
    """

    poisson: np.ndarray
    angular: np.ndarray
    nodes: np.ndarray
    columns: np.ndarray
    rotations: np.ndarray
    solved: list[ReducedModes]

    def node(self, poisson: float) -> int:
        """Return the place of the node that is nearest to a Poisson's ratio, the lower one of two."""
        return int(np.abs(self.nodes - poisson).argmin())


def build_stops(basis: ModalBasis, named, columns: int, modes: int, corrected: bool = True) -> Stops:
    """Return a body at every stop of its basis, and at the Poisson's ratios ``named``, whose shapes are kept.

    ``columns`` is how many columns there are at most. ``modes`` and ``corrected`` are as in
    :func:`vibraverse.physics.modes.solve_material`.
    """
    named = sorted({float(one) for one in named})
    poisson = np.unique([*_even_stops(*basis.poisson_range), *named])
    modes = min(modes, len(basis.residuals))
    solved = [reduced_solve(basis, one, modes, corrected) for one in poisson]
    nodes = _spread(poisson, named)
    shapes = np.hstack([solved[place].coefficients for place in np.searchsorted(poisson, nodes)])
    half, inverse = _mass_root(basis, len(shapes))
    shapes = half @ shapes
    weight = np.repeat(np.where(np.isin(nodes, named), _NAMED_WEIGHT, 1.0), modes)
    left, singular, _ = np.linalg.svd(shapes * weight, full_matrices=False)
    left = left[:, singular > _SMALLEST * singular[0]][:, :columns]
    return Stops(
        poisson=poisson,
        angular=np.sqrt([one.values for one in solved]),
        nodes=nodes,
        columns=inverse @ left,
        rotations=(shapes.T @ left).reshape(len(nodes), -1, left.shape[1]),
        solved=solved,
    )


def _even_stops(low: float, high: float) -> list[float]:
    """Return the ends of a range and the multiples of :data:`STEP` in it."""
    first, last = np.ceil(low / STEP - 1e-9), np.floor(high / STEP + 1e-9)
    return [low, high, *(round(float(number) * STEP, DIGITS) for number in np.arange(first, last + 1))]


def _spread(poisson: np.ndarray, named: list[float]) -> np.ndarray:
    """Return :data:`NODES` of the stops, ascending: the named ones, the ends, and each time the farthest from these."""
    chosen = list(dict.fromkeys([*named, float(poisson[0]), float(poisson[-1])]))
    while len(chosen) < min(NODES, len(poisson)):
        away = np.abs(poisson[:, None] - chosen).min(axis=1)
        chosen.append(float(poisson[away.argmax()]))
    return np.sort(chosen)


def _mass_root(basis: ModalBasis, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return ``R`` with ``RᵀR = M`` for the mass matrix of basis and corrections, and its inverse."""
    mass = np.eye(size)
    rank = len(basis.a_mu)
    if size > rank:
        mass[:rank, rank:], mass[rank:, :rank] = basis.correction_mass, basis.correction_mass.T
    values, vectors = np.linalg.eigh(mass)
    root = np.sqrt(np.maximum(values, _SMALLEST_MASS * values[-1]))
    return root[:, None] * vectors.T, vectors / root
