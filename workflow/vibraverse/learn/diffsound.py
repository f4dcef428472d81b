"""Reconstruction of one body from its eigenvalues by gradient descent through the physics (DiffSound, Jin et al. 2024).

Nothing is trained beforehand. A network adds to a first guess of the signed distance on a lattice of tetrahedra;
the inside becomes linear tetrahedra, whose eigenvalues are compared with the wanted ones, and derivatives by
Hellmann and Feynman lead back to the network.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import nn

from vibraverse.geometry.lattice import inside, lattice
from vibraverse.learn.networks.siren import Siren
from vibraverse.physics.differentiable import derivatives
from vibraverse.physics.elasticity import assemble
from vibraverse.physics.materials import lame

#: Shift of the eigensolver relative to the smallest wanted eigenvalue; negative, so the matrix is positive definite.
_SHIFT = -0.5
_RIGID = 6
#: Distance by which a point of known side lies inside or outside before it costs nothing, in cells of the lattice.
_SIDE_MARGIN = 0.25


class EmptyLevelSetError(Exception):
    """Nothing, or too little for the wanted modes, lies inside."""


@dataclass(frozen=True)
class Grid:
    """A lattice with ``cells`` per side of [-1, 1]³: ``points`` (N, 3) and ``tets`` (T, 4)."""

    cells: int
    points: np.ndarray = field(init=False)
    tets: np.ndarray = field(init=False)

    def __post_init__(self):
        points, tets = lattice(self.cells)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "tets", tets)


class Eigenvalues(torch.autograd.Function):
    """Elastic eigenvalues ω² (modes,) of what lies inside, for unit density and Young's modulus, by distances (N,)."""

    @staticmethod
    def forward(ctx, distance: torch.Tensor, grid: Grid, poisson: float, modes: int, near: float):
        """Solve near the smallest eigenvalue ``near``; raise :class:`EmptyLevelSetError` if too little is inside."""
        from scipy.sparse.linalg import eigsh

        cut = inside(grid.points, grid.tets, distance.detach().cpu().double().numpy())
        wanted = modes + _RIGID
        if 3 * len(cut.vertices) <= 2 * wanted:
            raise EmptyLevelSetError
        operators = assemble(cut.vertices, cut.cells, order=1)
        lam, mu = lame(1.0, poisson)
        # A start that is always the same: equal inputs give equal bytes.
        start = np.random.default_rng(0).standard_normal(operators.unknowns)
        values, vectors = eigsh(
            operators.stiffness(lam, mu), wanted, operators.mass, sigma=_SHIFT * near, v0=start, tol=1e-8
        )
        order = np.argsort(values)[_RIGID:]
        found = derivatives(operators, lam, mu, values[order], vectors[:, order])
        ctx.slopes = torch.from_numpy(cut.pull_back(found.vertices, len(grid.points)))
        return torch.from_numpy(values[order]).to(distance)

    @staticmethod
    def backward(ctx, gradient: torch.Tensor):
        """Return the gradient by distances."""
        return gradient @ ctx.slopes.to(gradient), None, None, None, None


def eigenvalues(
    field: Callable[[np.ndarray], np.ndarray], cells: int, poisson: float, modes: int
) -> np.ndarray:
    """Return ω² (modes,) of a signed distance's inside on a lattice, for unit density and Young's modulus.

    Raises :class:`EmptyLevelSetError` if too little is inside.
    """
    grid = Grid(cells)
    distance = torch.from_numpy(np.asarray(field(grid.points), dtype=float))
    return Eigenvalues.apply(distance, grid, poisson, modes, 1.0).numpy()


@dataclass(frozen=True)
class Settings:
    """How long and how finely to search: lattice cells per side, iterations, size of the network, weights."""

    cells: int = 32
    iterations: int = 200
    width: int = 64
    layers: int = 3
    learning_rate: float = 1e-3
    side_weight: float = 10.0


@dataclass(frozen=True)
class Found:
    """The best distances (N,) on the lattice, and by iteration the loss of the spectrum and of the sides.

    ``spectrum`` is NaN where the level set was empty.
    """

    distance: np.ndarray
    spectrum: list[float]
    sides: list[float]
    seconds: float


def search(
    wanted: np.ndarray,
    poisson: float,
    first: Callable[[np.ndarray], np.ndarray],
    known: tuple[np.ndarray, np.ndarray],
    settings: Settings,
    seed: int,
) -> Found:
    """Return the shape whose eigenvalues come nearest to ``wanted`` (m,), ω² for E = ρ = 1 in units of [-1, 1]³.

    ``first`` gives the first guess of the distance at points (n, 3). ``known`` are points (k, 3) and their sides (k,):
    -1 inside, 1 outside. The loss is the mean square of the relative differences of eigenvalues, and of how far known
    points lie on the wrong side, in cells.

    Raises :class:`EmptyLevelSetError` if the first guess is empty.
    """
    began = time.perf_counter()
    grid = Grid(settings.cells)
    torch.manual_seed(seed)
    network = Siren(3, settings.width, settings.layers, 1, normalised=False)
    nn.init.zeros_(network.last.weight)
    nn.init.zeros_(network.last.bias)
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    target = torch.from_numpy(np.asarray(wanted, dtype=float))
    cell = 2.0 / settings.cells
    places = [torch.from_numpy(points).float() for points in (grid.points, known[0])]
    guesses = [torch.from_numpy(np.asarray(first(points), dtype=float)) for points in (grid.points, known[0])]
    signs = torch.from_numpy(np.asarray(known[1], dtype=float))
    best, best_loss = None, np.inf
    spectra, sides = [], []
    for _ in range(settings.iterations):
        optimiser.zero_grad()
        on_grid, at_known = (
            guess + network(place)[:, 0].double() for guess, place in zip(guesses, places, strict=True)
        )
        side = nn.functional.relu(_SIDE_MARGIN - signs * at_known / cell).square().mean()
        try:
            values = Eigenvalues.apply(on_grid, grid, poisson, len(target), float(target[0]))
            spectrum = ((values - target) / target).square().mean()
        except EmptyLevelSetError:
            if best is None:
                raise
            spectrum = torch.tensor(np.nan)
        spectra.append(spectrum.item())
        sides.append(side.item())
        loss = settings.side_weight * side + (0.0 if spectrum.isnan() else spectrum)
        if not spectrum.isnan() and loss.item() < best_loss:
            best, best_loss = on_grid.detach().numpy().copy(), loss.item()
        loss.backward()
        optimiser.step()
    return Found(best, spectra, sides, time.perf_counter() - began)
