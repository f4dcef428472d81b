"""Derivatives of eigenvalues against differences, symmetries and scaling."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from meshes import box, distorted_box
from vibraverse.contract.seeds import rng
from vibraverse.physics.differentiable import clusters, derivatives
from vibraverse.physics.elasticity import assemble
from vibraverse.physics.materials import lame

LAM, MU = lame(1.0, 0.3)
MODES = slice(6, 14)


def solved(points, cells, order, lam=LAM, mu=MU):
    """Return operators, ω² and M-orthonormal modes of a few elements, from dense matrices."""
    operators = assemble(points, cells, order)
    values, vectors = scipy.linalg.eigh(operators.stiffness(lam, mu).toarray(), operators.mass.toarray())
    return operators, values[MODES], vectors[:, MODES]


@pytest.fixture(scope="module", params=[1, 2])
def body(request):
    """An irregular body of elements of an order, without clusters."""
    points, cells = distorted_box((1.0, 0.8, 0.5), (3, 2, 2), 0.05, rng("differentiable"))
    points[:, 2] += 0.2 * points[:, 0] ** 2
    return points, cells, request.param


def test_moving_vertices(body):
    points, cells, order = body
    operators, values, vectors = solved(points, cells, order)
    found = derivatives(operators, LAM, MU, values, vectors)
    assert len(set(found.clusters)) == len(found.clusters)
    random, step = rng("moves"), 1e-5
    for _ in range(4):
        move = random.standard_normal(points.shape)
        ahead, back = (solved(points + sign * step * move, cells, order)[1] for sign in (1, -1))
        expected = (ahead - back) / (2 * step)
        np.testing.assert_allclose(
            np.einsum("mva,va->m", found.vertices, move), expected, rtol=1e-5, atol=1e-5
        )


def test_moving_one_vertex_moves_only_what_touches_it(body):
    points, cells, order = body
    operators, values, vectors = solved(points, cells, order)
    found = derivatives(operators, LAM, MU, values, vectors)
    vertex, step = 7, 1e-5
    for axis in range(3):
        move = np.zeros_like(points)
        move[vertex, axis] = step
        expected = (solved(points + move, cells, order)[1] - solved(points - move, cells, order)[1]) / (
            2 * step
        )
        np.testing.assert_allclose(found.vertices[:, vertex, axis], expected, rtol=1e-5, atol=1e-5)


def test_materials(body):
    points, cells, order = body
    operators, values, vectors = solved(points, cells, order)
    found = derivatives(operators, LAM, MU, values, vectors)
    np.testing.assert_allclose(LAM * found.lam + MU * found.mu, values, rtol=1e-9)
    step = 1e-6
    ahead, back = (solved(points, cells, order, LAM + sign * step)[1] for sign in (1, -1))
    np.testing.assert_allclose(found.lam, (ahead - back) / (2 * step), rtol=1e-5, atol=1e-7)


def test_moving_and_turning_changes_nothing_and_growing_what_it_must(body):
    points, cells, order = body
    operators, values, vectors = solved(points, cells, order)
    found = derivatives(operators, LAM, MU, values, vectors).vertices
    scale = np.abs(found).max()
    np.testing.assert_allclose(found.sum(axis=1), 0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(np.cross(points, found).sum(axis=1), 0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(np.einsum("mva,va->m", found, points), -2.0 * values, rtol=1e-8)


def test_members_of_a_cluster_have_the_derivative_of_their_mean():
    """A cube has modes in twos and threes, which a move tears apart: their sum has a derivative all the same."""
    points, cells = box((1.0, 1.0, 1.0), (2, 2, 2))
    operators, values, vectors = solved(points, cells, 2)
    found = derivatives(operators, LAM, MU, values, vectors, cluster=1e-6)
    sizes = np.bincount(found.clusters)
    assert sizes.max() >= 2
    move = rng("cube").standard_normal(points.shape)
    step = 1e-6
    ahead, back = (solved(points + sign * step * move, cells, 2)[1] for sign in (1, -1))
    expected = (ahead - back) / (2 * step)
    slopes = np.einsum("mva,va->m", found.vertices, move)
    for number in np.flatnonzero(sizes[:-1] > 0):  # the last cluster may go on beyond these modes
        members = found.clusters == number
        assert slopes[members].sum() == pytest.approx(expected[members].sum(), rel=1e-4, abs=1e-4)


def test_clusters_are_neighbours_closer_than_the_tolerance():
    np.testing.assert_array_equal(
        clusters(np.array([1.0, 1.00001, 1.00002, 2.0, 3.0, 3.0]), 1e-4), [0, 0, 0, 1, 2, 2]
    )
