"""Rayleigh–Ritz in the span of given displacement fields, and what all mechanical baselines return.

By Rayleigh–Ritz, the k-th value in any subspace orthogonal to the rigid motions is an upper bound of the k-th elastic
eigenvalue. So the fields of a network and polynomials are compared on equal terms.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from vibraverse.physics.columns import orthonormalise, product, project_out, rayleigh_ritz
from vibraverse.physics.elasticity import Operators, rigid_modes
from vibraverse.physics.materials import lame

#: A unit field of which less than this share is elastic is a rigid motion within rounding.
_RIGID_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Spectrum:
    """Frequencies (m,) in Hz, ascending, and the CPU seconds of each part of the computation."""

    frequencies_hz: np.ndarray
    seconds: dict[str, float]

    @property
    def total_seconds(self) -> float:
        """CPU seconds of all parts."""
        return sum(self.seconds.values())


class Clock:
    """CPU seconds by part."""

    def __init__(self):
        self.seconds: dict[str, float] = {}

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Add the CPU time of the block to a part."""
        began = time.process_time()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - began


def hertz(values: np.ndarray, material: dict, scale_m: float) -> np.ndarray:
    """Return frequencies in Hz from ω² for E = ρ = 1; ``scale_m`` is metres per mesh unit."""
    return np.sqrt(values * material["young_pa"] / material["density_kg_m3"]) / scale_m / (2 * np.pi)


def elastic_basis(mass: sp.csr_matrix, fields: np.ndarray, rigid: np.ndarray | None = None) -> np.ndarray:
    """Return an M-orthonormal basis (n, r) of the span of ``fields`` (n, m), free of rigid motions.

    ``rigid`` (n, 6) are the rigid motions, which are projected out; without them the fields must be free of rigid
    motions. Fields may be of any size and dependent: they are M-orthonormalised by singular values (SVQB: Stathopoulos
    and Wu, SIAM J. Sci. Comput. 23, 2165, 2002), and directions within rounding are dropped.
    """
    space = np.array(fields, dtype=float)
    norms = np.sqrt(np.vecdot(space.T, product(mass, space).T))
    space = space[:, norms > 0] / norms[norms > 0]
    if rigid is not None:
        known, weighted, _ = orthonormalise(rigid, mass)
        project_out(space, known, weighted)
        left = np.sqrt(np.vecdot(space.T, product(mass, space).T))
        space = space[:, left > _RIGID_TOLERANCE]
    if space.shape[1]:
        space, _, _ = orthonormalise(space, mass)
    if rigid is not None:
        # Orthonormalisation amplifies what rounding left of the rigid motions.
        project_out(space, known, weighted)
    return space


def ritz(
    stiffness: sp.csr_matrix,
    mass: sp.csr_matrix,
    fields: np.ndarray,
    modes: int,
    rigid: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the lowest Ritz pairs of ``K u = ω² M u`` in the span of ``fields`` (n, m), see :func:`elastic_basis`.

    Returns ω² (modes,), the M-orthonormal vectors (n, modes) and relative residuals (modes,).

    Raises :class:`ValueError` if fewer than ``modes`` independent elastic fields are left.
    """
    space = elastic_basis(mass, fields, rigid)
    check_enough(fields, space, modes)
    values, vectors, residuals = rayleigh_ritz(space, stiffness, mass)
    return values[:modes], vectors[:, :modes], residuals[:modes]


def check_enough(fields: np.ndarray, space: np.ndarray, modes: int) -> None:
    """Raise :class:`ValueError` if the basis (n, r) of ``fields`` (n, m) has fewer directions than ``modes``."""
    if space.shape[1] < modes:
        raise ValueError(
            f"The {fields.shape[1]} fields span {space.shape[1]} elastic directions, too few for {modes} modes; "
            "give more fields, or ask for fewer modes"
        )


def at_nodes(operators: Operators, values: np.ndarray) -> np.ndarray:
    """Return values (N, k) of the vertices at all nodes of quadratic elements: in edges' middles the ends' means."""
    return np.concatenate([values, values[operators.mesh.edges].mean(axis=0)])


def from_fields(
    operators: Operators, fields: np.ndarray, material: dict, scale_m: float, modes: int = 64
) -> Spectrum:
    """Return the frequencies of a body in the span of displacement ``fields`` (n, m) on its tetrahedra."""
    clock = Clock()
    with clock.part("ritz"):
        stiffness = operators.stiffness(*lame(1.0, material["poisson"]))
        values, _, _ = ritz(stiffness, operators.mass, fields, modes, rigid_modes(operators.nodes))
    return Spectrum(hertz(values, material, scale_m), clock.seconds)
