"""Starts of an iteration on the elements' unknowns: random, polynomial, linear elements.

Each returns displacements (n, block) at the nodes of the operators; components are interleaved. Learned fields are a
start as they are.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry.boundary import boundary
from vibraverse.learn.baselines.galerkin import at_nodes
from vibraverse.learn.baselines.polynomials import polynomial_space
from vibraverse.physics.eigensolver import solve
from vibraverse.physics.elasticity import Operators, assemble


def random(operators: Operators, block: int, rng: np.random.Generator) -> np.ndarray:
    """Return normally distributed displacements."""
    return rng.standard_normal((operators.unknowns, block))


def polynomial(operators: Operators, block: int, poisson: float, degree: int = 8) -> np.ndarray:
    """Return the lowest polynomial Ritz modes of the body."""
    faces, used = boundary(_cells(operators))
    space = polynomial_space(operators.nodes[used], faces, degree)
    return space.fields(operators.nodes, space.modes(poisson, block)[1])


def linear(operators: Operators, block: int, poisson: float, rng: np.random.Generator) -> np.ndarray:
    """Return the lowest modes of linear elements on the same tetrahedra, interpolated to quadratic ones.

    Linear elements have an eighth of the unknowns, and their functions are quadratic ones, too: the value amid an edge
    is the mean of its ends.
    """
    points, cells = operators.mesh.p.T, _cells(operators)
    coarse = assemble(points, cells, 1)
    vectors = solve(coarse, poisson, block, rng=rng, tolerance=1e-3).vectors
    if operators.order == 1:
        return vectors
    fine = at_nodes(operators, vectors.reshape(len(points), -1))
    return fine.reshape(3 * len(operators.nodes), -1)


def _cells(operators: Operators) -> np.ndarray:
    """Return the tetrahedra (T, 4) positively oriented; the operators keep them with ascending vertices."""
    points, cells = operators.mesh.p.T, operators.mesh.t.T.copy()
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    turned = np.linalg.det(edges) < 0
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    return cells
