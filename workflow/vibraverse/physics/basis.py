"""The material-independent modal basis of a body.

With E = ρ = 1 and the mesh in its own units, all parameters but Poisson's ratio ν only scale the problem. So the
sparse problem is solved at one ν in the middle of the wanted range. The space of its modes then grows by corrections at
the ends of the range and wherever the estimated error is largest. It is complete when every frequency in the range is
accurate enough (:mod:`vibraverse.physics.reduction`). The operators are projected onto that space U once:

    A_λ = Uᵀ K_λ U,   A_μ = Uᵀ K_μ U,   Uᵀ M U = I.

A material then needs only the dense problem ``(λ A_λ + μ A_μ) c = ω² c`` of about two hundred unknowns. By
Rayleigh–Ritz its frequencies are upper bounds of the mesh's exact ones, and the error of each is estimated without the
sparse matrices. The discretisation error of the elements is estimated, and mostly removed, by the corrections of
:mod:`vibraverse.physics.enrichment`.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry.boundary import boundary
from vibraverse.physics.columns import combine, signs
from vibraverse.physics.eigensolver import RIGID, solve
from vibraverse.physics.elasticity import Operators, assemble
from vibraverse.physics.enrichment import correct
from vibraverse.physics.factorisation import factorise
from vibraverse.physics.materials import lame
from vibraverse.physics.reduced import GUARD, ModalBasis, solve_reduced
from vibraverse.physics.reduction import Reduction

#: Largest factor by which ``1 - 2ν`` changes over the part of the range that one factorisation serves.
_SHIFT_FACTOR = 4.0
#: Numbers of ν per part at which errors are checked, in rounds: the ends, where errors are largest; some more; and
#: many, because a mode may be among the lowest only between two others.
_ERROR_PROBES = (2, 7, 16)
#: Most corrections per round; if they do not suffice, the error estimates stay valid.
_MAX_CORRECTIONS = 20
#: Every mode whose error exceeds this share of the wanted error is corrected.
_CORRECTION_THRESHOLD = 0.5
#: Shares of the wanted error that may remain after the corrections and after the compression. The margin covers the
#: estimates, which are accurate to 20 % and made at some ν only.
_CORRECTION_TARGET, _COMPRESSION_TARGET = 0.7, 0.8
#: Thresholds for dropping directions in the end; the first one that keeps the wanted error is taken.
_DROP_TOLERANCES = (1e-3, 5e-4, 2e-4, 1e-4, 3e-5, 1e-5)


def build_basis(
    points: np.ndarray,
    cells: np.ndarray,
    *,
    rng: np.random.Generator,
    order: int = 2,
    modes: int = 64,
    poisson_range: tuple[float, float] = (0.1, 0.4),
    max_error: float = 1e-5,
    method: str = "auto",
    factorisation: str = "auto",
    tolerance: float = 1e-3,
) -> ModalBasis:
    """Solve for the modal basis of a tetrahedral mesh.

    ``points`` (N, 3) and ``cells`` (T, 4) in any length unit, ``modes`` elastic modes. Frequencies scale with
    ``sqrt(E/ρ)`` over that unit. ``max_error`` is the relative frequency error that the basis may add in
    ``poisson_range``; ``tolerance`` is that of :func:`vibraverse.physics.eigensolver.solve`.

    Raises :class:`vibraverse.contract.errors.Refused` if the mesh is invalid or the solve fails.
    """
    operators = assemble(points, cells, order)
    solved = min(modes + GUARD, max(modes, operators.unknowns - RIGID - 2))
    centres = _centres(*poisson_range)
    centre = centres[0]
    pairs = solve(
        operators, centre, solved, rng=rng, method=method, factorisation=factorisation, tolerance=tolerance
    )
    factor = pairs.factor
    if factor is None:
        factor = factorise(operators.shifted(*lame(1.0, centre), pairs.shift), factorisation)
    space = Reduction(operators, pairs.vectors)
    nodes, probes = [centre], []
    for poisson in centres:
        if poisson != centre:
            factor.update(operators.shifted(*lame(1.0, poisson), pairs.shift))
        space.use(factor, poisson, pairs.shift, rng)
        for count in _ERROR_PROBES:
            near = _probes(poisson, centres, *poisson_range, count)
            nodes += _extend(space, modes, solved, near, max_error)
            probes = sorted({*probes, *near})
    turn, error = _compress(space, modes, probes, max_error)
    faces, surface_nodes = boundary(cells)
    on_surface = _positions(cells, surface_nodes)
    surface = _values_at(on_surface, space.vectors) @ space.in_vectors(turn)
    sign = signs(surface.reshape(-1, surface.shape[2]))
    turn, surface = turn * sign, surface * sign
    a_lambda, a_mu, sketch = space.turned(turn)
    if len(centres) > 1:
        factor.update(operators.shifted(*lame(1.0, centre), pairs.shift))
    lowest, coefficients, _ = space.solve(centre, modes, solved - modes)
    lowest_modes = combine(space.vectors, space.in_vectors(coefficients))
    corrections = correct(operators, factor, pairs.shift, centre, space.vectors, lowest, lowest_modes).turned(
        space.in_vectors(turn)
    )
    volume, middle, inertia = rigid_body(operators)
    return ModalBasis(
        a_lambda=a_lambda,
        a_mu=a_mu,
        sketch=sketch,
        energy_poisson=space.energy_poisson,
        vertices=points[surface_nodes],
        faces=faces,
        surface=surface,
        correction_lambda=corrections.k_lambda,
        correction_mu=corrections.k_mu,
        correction_mass=corrections.mass,
        correction_surface=_values_at(on_surface, corrections.vectors),
        poisson_range=np.array(poisson_range, dtype=float),
        poisson_nodes=np.array(nodes),
        error=error,
        residuals=pairs.residuals[:modes],
        volume=volume,
        centre=middle,
        inertia=inertia,
        order=order,
        n_vertices=operators.n_vertices,
        n_tetrahedra=len(cells),
        n_unknowns=operators.unknowns,
        method=pairs.method,
        factorisation=factor.name,
    )


def _centres(low: float, high: float) -> list[float]:
    """Return the ν at which matrices are factorised, the middle one first.

    ``1 - 2ν`` measures the stiffness against compression. The range is divided into equal parts of its logarithm, so
    that the factorisation in the middle of a part is close enough to every ν of the part.
    """
    first, last = np.log(1 - 2 * low), np.log(1 - 2 * high)
    count = max(1, int(np.ceil((first - last) / np.log(_SHIFT_FACTOR) - 1e-9)))
    middles = 0.5 * (1 - np.exp(first + (last - first) * (np.arange(count) + 0.5) / count))
    order = np.argsort(np.abs(np.arange(count) - (count - 1) / 2), kind="stable")
    return [float(poisson) for poisson in middles[order]]


def _probes(centre: float, centres: list[float], low: float, high: float, count: int) -> list[float]:
    """Return the ν at which errors are checked, in the part of the range around ``centre``: Chebyshev points."""
    places = np.log(1 - 2 * np.array([low, high]))
    half = 0.5 * (places[0] - places[1]) / len(centres)
    steps = half * np.cos(np.linspace(0, np.pi, count)) if high > low else np.zeros(1)
    return [float(poisson) for poisson in 0.5 * (1 - (1 - 2 * centre) * np.exp(steps))]


def _extend(space: Reduction, modes: int, solved: int, probes: list[float], max_error: float) -> list[float]:
    """Extend the space by corrections until no frequency at the ``probes`` has an error above ``max_error``.

    Returns the ν of the corrections, in order.
    """
    nodes: list[float] = []
    for _ in range(_MAX_CORRECTIONS):
        found = {poisson: space.solve(poisson, modes, solved - modes) for poisson in probes}
        errors = {poisson: error[:modes].max() for poisson, (_, _, error) in found.items()}
        # Errors only fall as the space grows, so a probe that is good enough needs no second check.
        probes = [poisson for poisson in probes if errors[poisson] > _CORRECTION_TARGET * max_error]
        if not probes:
            break
        worst = max(probes, key=errors.get)
        values, coefficients, error = found[worst]
        columns = error > _CORRECTION_THRESHOLD * max_error
        space.correct(worst, values[columns], coefficients[:, columns], max_error)
        nodes.append(worst)
    return nodes


def _compress(
    space: Reduction, modes: int, probes: list[float], max_error: float
) -> tuple[np.ndarray, float]:
    """Return an orthonormal ``turn`` (r, s) to the directions that the ``probes`` need, and the largest error."""
    needed = np.concatenate([space.solve(poisson, modes, 1)[1] for poisson in probes], axis=1)
    for drop in _DROP_TOLERANCES:
        turn = space.needed(needed, drop)
        reduced = *space.turned(turn), space.energy_poisson
        error = max(solve_reduced(*reduced, poisson, modes)[2].max() for poisson in probes)
        if error <= _COMPRESSION_TARGET * max_error:
            break
    return turn, float(error)


def _positions(cells: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return the positions of the given points among those that the cells use."""
    return np.searchsorted(np.unique(cells), nodes)


def _values_at(nodes: np.ndarray, fields: np.ndarray) -> np.ndarray:
    """Return the values (V, 3, m) of fields (3n, m) at some nodes (V,)."""
    return fields[(3 * nodes[:, None] + np.arange(3)).ravel()].reshape(len(nodes), 3, -1)


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
