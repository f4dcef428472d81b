"""Level sets on a lattice: volumes, closed conforming meshes, derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from vibraverse.contract.seeds import rng
from vibraverse.geometry.boundary import boundary
from vibraverse.geometry.lattice import Cut, inside, lattice
from vibraverse.physics.differentiable import derivatives
from vibraverse.physics.elasticity import assemble, check_tetrahedra
from vibraverse.physics.materials import lame

LAM, MU = lame(1.0, 0.3)


def volume(cut: Cut) -> float:
    return float(check_tetrahedra(cut.vertices, cut.cells).sum())


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the directed edges of triangles and how often each undirected one occurs."""
    directed = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    return directed, np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)[1]


@pytest.fixture(scope="module")
def bumpy() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A lattice and a level set without symmetries, whose cuts show all sixteen patterns."""
    points, tets = lattice(5)
    x, y, z = points.T
    return points, tets, 0.9 * x**2 + 1.3 * y**2 + 1.7 * z**2 + 0.3 * x * y + 0.21 * z - 0.63


def test_all_of_a_lattice_is_its_cube():
    points, tets = lattice(3, half=0.5)
    assert points.shape == (64, 3)
    assert tets.shape == (162, 4)
    assert (np.diff(tets, axis=1) > 0).all()
    assert volume(inside(points, tets, -np.ones(64))) == pytest.approx(1.0)


def test_a_plane_divides_the_cube():
    points, tets = lattice(4)
    normal = np.array([0.48, 0.6, 0.64])
    for offset in (-0.31, 0.0, 0.27):
        below, above = (inside(points, tets, sign * (points @ normal - offset)) for sign in (1, -1))
        for cut in (below, above):
            free = cut.slopes.any(axis=1)
            np.testing.assert_allclose(cut.vertices[free] @ normal, offset, atol=1e-12)
        assert volume(below) + volume(above) == pytest.approx(8.0, rel=2e-3)  # cuts beside a corner are moved


def test_a_ball_has_its_volume_at_second_order():
    errors = []
    for cells in (12, 24):
        points, tets = lattice(cells)
        cut = inside(points, tets, np.linalg.norm(points, axis=1) - 0.8)
        errors.append(abs(volume(cut) / (4 / 3 * np.pi * 0.8**3) - 1))
    assert errors[1] < 0.01
    assert errors[1] < 0.35 * errors[0]


def test_the_sides_of_neighbours_meet(bumpy):
    """Every side belongs to two tetrahedra or to the boundary, which is closed and oriented."""
    points, tets, distance = bumpy
    cut = inside(points, tets, distance)
    patterns = (distance < 0)[tets] @ (1 << np.arange(4))
    assert len(np.unique(patterns)) == 16
    sides = np.sort(cut.cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    assert np.unique(sides, axis=0, return_counts=True)[1].max() == 2
    faces, nodes = boundary(cut.cells)
    directed, counts = edges_of(faces)
    assert (counts == 2).all()
    assert len(np.unique(directed, axis=0)) == len(directed)
    corners = cut.vertices[nodes][faces]
    enclosed = np.linalg.det(corners).sum() / 6
    assert enclosed == pytest.approx(volume(cut), rel=1e-12)
    assert len(nodes) - len(counts) + len(faces) == 2  # Euler: a sphere


def test_only_the_largest_part_is_kept():
    points, tets = lattice(10)
    large, small = (np.linalg.norm(points - at, axis=1) for at in ([0.4, 0, 0], [-0.6, 0, 0]))
    cut = inside(points, tets, np.minimum(large - 0.5, small - 0.3))
    assert cut.vertices[:, 0].min() > -0.2
    assert volume(cut) == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=0.08)


def test_nothing_inside_has_no_tetrahedra():
    points, tets = lattice(2)
    assert inside(points, tets, np.ones(len(points))).cells.shape == (0, 4)


def test_the_volume_has_a_derivative(bumpy):
    points, tets, distance = bumpy
    cut = inside(points, tets, distance)
    corners = cut.vertices[cut.cells]
    by_vertices = np.zeros_like(cut.vertices)
    for corner in range(
        4
    ):  # the gradient of a tetrahedron's volume by a corner: a third of the opposite side's area
        a, b, c = (corners[:, (corner + i) % 4] for i in (1, 2, 3))
        sign = -1 if corner % 2 == 0 else 1
        np.add.at(by_vertices, cut.cells[:, corner], sign * np.cross(b - a, c - a) / 6)
    found = cut.pull_back(by_vertices, len(points))
    move, step = rng("volume").standard_normal(len(points)), 1e-7
    ahead, back = (volume(inside(points, tets, distance + sign * step * move)) for sign in (1, -1))
    assert found @ move == pytest.approx((ahead - back) / (2 * step), rel=1e-5)


def test_eigenvalues_have_derivatives_by_distances(bumpy):
    points, tets, distance = bumpy

    def solved(values):
        cut = inside(points, tets, values)
        operators = assemble(cut.vertices, cut.cells, order=1)
        return (
            cut,
            operators,
            scipy.linalg.eigh(operators.stiffness(LAM, MU).toarray(), operators.mass.toarray()),
        )

    cut, operators, (values, vectors) = solved(distance)
    found = derivatives(operators, LAM, MU, values[6:14], vectors[:, 6:14])
    assert len(set(found.clusters)) == 8
    slopes = cut.pull_back(found.vertices, len(points))
    random, step = rng("eigenvalues"), 1e-6
    for _ in range(3):
        move = random.standard_normal(len(points))
        ahead, back = (solved(distance + sign * step * move)[2][0][6:14] for sign in (1, -1))
        np.testing.assert_allclose(slopes @ move, (ahead - back) / (2 * step), rtol=1e-5, atol=1e-5)


def test_eigenvalues_have_a_derivative_by_the_walls_thickness():
    """A wall is what lies inside, but less deep than it is thick."""
    points, tets = lattice(8)
    distance = np.linalg.norm(points * [1.0, 1.1, 1.25], axis=1) - 0.83

    def solved(wall):
        cut = inside(points, tets, np.maximum(distance, -wall - distance))
        operators = assemble(cut.vertices, cut.cells, order=1)
        matrices = operators.stiffness(LAM, MU), operators.mass
        return cut, operators, scipy.linalg.eigh(*(matrix.toarray() for matrix in matrices))

    wall, step = 0.47, 1e-6
    cut, operators, (values, vectors) = solved(wall)
    by_distance = cut.pull_back(
        derivatives(operators, LAM, MU, values[6:14], vectors[:, 6:14]).vertices, len(points)
    )
    found = by_distance @ np.where(-wall - distance > distance, -1.0, 0.0)
    ahead, back = (solved(wall + sign * step)[2][0][6:14] for sign in (1, -1))
    np.testing.assert_allclose(found, (ahead - back) / (2 * step), rtol=1e-5, atol=1e-5)
