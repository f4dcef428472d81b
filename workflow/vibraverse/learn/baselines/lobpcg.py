"""LOBPCG in PyTorch, so that it runs on GPUs: double precision, soft locking, any start and preconditioner.

The method is Knyazev's (SIAM J. Sci. Comput. 23, 517, 2001) with the basis of Hetmaniuk and Lehoucq (J. Comput. Phys.
218, 324, 2006) and Duersch et al. (SIAM J. Sci. Comput. 40, C655, 2018): the directions P are made orthogonal to the
new iterates by small dense algebra, and only the preconditioned residuals W are orthonormalised in the large space, by
singular values. So the Rayleigh–Ritz step is a standard eigenproblem of at most three blocks. Rigid motions are
projected out. Converged columns stay in the block, but get no new directions (soft locking; Knyazev et al., SIAM J.
Sci. Comput. 29, 2224, 2007).

``torch.lobpcg`` (2.15) was tried on a nut of 1,439 quadratic elements, with 64 elastic modes, a random start and the
diagonal as preconditioner. Its ``ortho`` method has a largest frequency error of 3e-2 after 50 iterations and 1e-8
after 150 (48 CPU s); this one 1e-4 after 50 and 3e-9 after 104 (26 CPU s). Its ``basic`` method still has 3e-3 after
150. It also takes a preconditioner only as a matrix, so no factorisation, must compute the rigid motions, and keeps no
residuals.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import torch

from vibraverse.learn.baselines.galerkin import Clock, Spectrum, hertz
from vibraverse.physics.eigensolver import shift_for
from vibraverse.physics.elasticity import Operators, rigid_modes
from vibraverse.physics.factorisation import factorise
from vibraverse.physics.materials import lame

#: Columns beyond the wanted modes: convergence depends on the gap to the first mode outside the block.
GUARD = 12
#: Directions whose weight is below this share of the largest are rounding errors.
_ROUNDING_SHARE = 1e-14

Preconditioner = Callable[[torch.Tensor], torch.Tensor]


@dataclass(frozen=True)
class Iteration:
    """What an iteration found: ``values`` ω² (m,) and ``vectors`` (n, m), M-orthonormal, on the CPU.

    ``history`` (k, m) are the residuals ``‖K u - ω² M u‖ / ‖ω² M u‖`` at the start of each iteration and at the end.
    ``applied`` counts columns that were preconditioned. ``cpu_seconds`` and ``wall_seconds`` leave out the start.
    """

    values: np.ndarray
    vectors: np.ndarray
    history: np.ndarray
    converged: bool
    applied: int
    cpu_seconds: float
    wall_seconds: float

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.history) - 1


def lobpcg(
    stiffness: sp.csr_matrix,
    mass: sp.csr_matrix,
    start: np.ndarray,
    modes: int,
    *,
    rigid: np.ndarray,
    precondition: Preconditioner,
    tolerance: float = 1e-4,
    max_iterations: int = 200,
    device: str = "cpu",
) -> Iteration:
    """Return the lowest elastic pairs of ``K u = ω² M u``, from ``start`` (n, block).

    ``rigid`` (n, 6) are the rigid motions. ``precondition`` maps residuals (n, k) to directions, as :func:`jacobi` and
    :func:`factorised` do. The iteration ends when all ``modes`` residuals are below ``tolerance``; eigenvalues are
    right to about its square. A start of more columns than ``modes`` + 12 is reduced to its best by Rayleigh–Ritz.

    Raises :class:`ValueError` if the start has fewer independent columns than ``modes``.
    """
    cpu, wall = time.process_time(), time.perf_counter()
    with torch.no_grad():
        problem = _Problem(stiffness, mass, rigid, device)
        x, kx, mx, values = _first(problem, torch.as_tensor(start, dtype=torch.float64, device=device), modes)
        p, kp, mp = (block[:, :0] for block in (x, kx, mx))
        history, applied = [], 0
        while True:
            residual = kx - mx * values
            size = residual.norm(dim=0) / (mx * values).norm(dim=0)
            history.append(size[:modes].cpu().numpy())
            active = size > tolerance
            if not active[:modes].any() or len(history) > max_iterations:
                break
            applied += int(active.sum())
            w = problem.orthonormal(precondition(residual[:, active]), [(x, mx), (p, mp)])
            kw, mw = problem.stiffness @ w, problem.mass @ w
            space, stiff, heavy = (
                torch.cat([x, p, w], 1),
                torch.cat([kx, kp, kw], 1),
                torch.cat([mx, mp, mw], 1),
            )
            found, turn = torch.linalg.eigh(_symmetric(space.T @ stiff))
            width = x.shape[1]
            best, values = turn[:, :width], found[:width]
            steps = _steps(best, active, width)
            both = torch.cat([best, steps], 1)
            (x, p), (kx, kp), (mx, mp) = (
                (block @ both).split([width, steps.shape[1]], dim=1) for block in (space, stiff, heavy)
            )
        found = x[:, :modes].cpu().numpy(), values[:modes].cpu().numpy()
    return Iteration(
        values=found[1],
        vectors=found[0],
        history=np.array(history),
        converged=bool((history[-1] <= tolerance).all()),
        applied=applied,
        cpu_seconds=time.process_time() - cpu,
        wall_seconds=time.perf_counter() - wall,
    )


def frequencies(
    operators: Operators,
    start: np.ndarray,
    material: dict,
    scale_m: float,
    *,
    modes: int = 64,
    preconditioner: str = "factorised",
    tolerance: float = 1e-3,
    max_iterations: int = 200,
    device: str = "cpu",
) -> tuple[Spectrum, Iteration]:
    """Return the frequencies of a body from a start (n, block) by :func:`lobpcg`, and the iteration.

    ``preconditioner`` is ``factorised`` or ``jacobi``. ``material`` holds ``young_pa``, ``density_kg_m3`` and
    ``poisson``; ``scale_m`` is metres per mesh unit. A frequency is right to about the square of the ``tolerance``. The
    CPU seconds leave out the start and the assembly.
    """
    clock = Clock()
    with clock.part("preconditioner"):
        constants = lame(1.0, material["poisson"])
        stiffness = operators.stiffness(*constants)
        shifted = operators.shifted(*constants, shift_for(stiffness, operators.mass, operators.nodes))
        make = {
            "factorised": lambda: factorised(factorise(shifted)),
            "jacobi": lambda: jacobi(shifted, device),
        }
        precondition = make[preconditioner]()
    with clock.part("iteration"):
        found = lobpcg(
            stiffness,
            operators.mass,
            start,
            modes,
            rigid=rigid_modes(operators.nodes),
            precondition=precondition,
            tolerance=tolerance,
            max_iterations=max_iterations,
            device=device,
        )
    return Spectrum(hertz(found.values, material, scale_m), clock.seconds), found


def jacobi(shifted: sp.csr_matrix, device: str = "cpu") -> Preconditioner:
    """Return the inverse of the 3×3 diagonal blocks of ``K - σM`` for a negative shift σ: one block per node."""
    n = shifted.shape[0] // 3
    blocks = np.zeros((n, 3, 3))
    by_row = shifted.tobsr((3, 3))
    rows = np.repeat(np.arange(n), np.diff(by_row.indptr))
    diagonal = by_row.indices == rows
    blocks[rows[diagonal]] = by_row.data[diagonal]
    inverse = torch.as_tensor(np.linalg.inv(blocks), device=device)
    return lambda residual: (inverse @ residual.reshape(n, 3, -1)).reshape(residual.shape)


def factorised(factor) -> Preconditioner:
    """Return the solve with a factorised ``K - σM`` (:mod:`vibraverse.physics.factorisation`), on the CPU."""

    def apply(residual: torch.Tensor) -> torch.Tensor:
        solved = np.ascontiguousarray(factor.solve(residual.cpu().numpy()))
        return torch.as_tensor(solved, device=residual.device)

    return apply


class _Problem:
    """The matrices and the rigid motions on a device."""

    def __init__(self, stiffness: sp.csr_matrix, mass: sp.csr_matrix, rigid: np.ndarray, device: str):
        self.stiffness, self.mass = _sparse(stiffness, device), _sparse(mass, device)
        rigid = torch.as_tensor(rigid, dtype=torch.float64, device=device)
        self._rigid, self._weighted = rigid, self.mass @ rigid
        turn = _orthonormalising(_symmetric(rigid.T @ self._weighted))
        self._rigid, self._weighted = rigid @ turn, self._weighted @ turn

    def orthonormal(
        self, block: torch.Tensor, known: list[tuple[torch.Tensor, torch.Tensor]]
    ) -> torch.Tensor:
        """Return an M-orthonormal basis of the block's part that is M-orthogonal to rigid motions and ``known``.

        ``known`` are pairs of an M-orthonormal block and its product with M. The second pass removes the rounding
        errors of the first.
        """
        for _ in range(2):
            for space, weighted in [(self._rigid, self._weighted), *known]:
                block = block - space @ (weighted.T @ block)
            block = block @ _orthonormalising(_symmetric(block.T @ (self.mass @ block)))
        return block


def _first(problem: _Problem, start: torch.Tensor, modes: int):
    """Return the Ritz vectors of the start with their products and values."""
    space = problem.orthonormal(start, [])
    if space.shape[1] < modes:
        raise ValueError(
            f"The start spans {space.shape[1]} elastic directions, too few for {modes} modes; give more columns"
        )
    stiff, heavy = problem.stiffness @ space, problem.mass @ space
    values, turn = torch.linalg.eigh(_symmetric(space.T @ stiff))
    turn = turn[:, : modes + GUARD]
    return space @ turn, stiff @ turn, heavy @ turn, values[: modes + GUARD]


def _steps(best: torch.Tensor, active: torch.Tensor, width: int) -> torch.Tensor:
    """Return the coefficients of the directions P: steps of active columns, orthonormal and orthogonal to ``best``."""
    steps = best[:, active].clone()
    steps[:width] = 0.0
    for _ in range(2):
        steps = steps - best @ (best.T @ steps)
        steps = steps @ _orthonormalising(_symmetric(steps.T @ steps))
    return steps


def _orthonormalising(gram: torch.Tensor) -> torch.Tensor:
    """Return ``turn`` (m, k) with ``turnᵀ gram turn = I``; see vibraverse.physics.columns."""
    scale = gram.diagonal().clamp(min=torch.finfo(gram.dtype).tiny).rsqrt()
    weights, directions = torch.linalg.eigh(gram * scale[:, None] * scale)
    kept = weights > _ROUNDING_SHARE * weights[-1]
    return scale[:, None] * directions[:, kept] * weights[kept].rsqrt()


def _symmetric(matrix: torch.Tensor) -> torch.Tensor:
    return 0.5 * (matrix + matrix.T)


def _sparse(matrix: sp.csr_matrix, device: str) -> torch.Tensor:
    matrix = matrix.tocsr()
    parts = (torch.as_tensor(part) for part in (matrix.indptr, matrix.indices, matrix.data))
    with warnings.catch_warnings():
        # PyTorch calls its compressed rows a beta; products with blocks are all that is used of them.
        warnings.filterwarnings("ignore", message="Sparse CSR tensor support is in beta")
        return torch.sparse_csr_tensor(
            *parts, size=matrix.shape, dtype=torch.float64, device=device, check_invariants=False
        )
