"""LOBPCG in PyTorch against LAPACK and the eigensolver."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
from scipy.spatial import cKDTree

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from meshes import distorted_box  # noqa: E402
from vibraverse.contract.seeds import rng  # noqa: E402
from vibraverse.learn.baselines import starts  # noqa: E402
from vibraverse.learn.baselines.lobpcg import factorised, frequencies, jacobi, lobpcg  # noqa: E402
from vibraverse.physics.columns import residuals  # noqa: E402
from vibraverse.physics.eigensolver import shift_for, solve  # noqa: E402
from vibraverse.physics.elasticity import assemble, rigid_modes  # noqa: E402
from vibraverse.physics.factorisation import factorise  # noqa: E402
from vibraverse.physics.materials import MATERIALS  # noqa: E402

pytestmark = pytest.mark.learn
MODES, BLOCK = 30, 40


class Lattice:
    """A free block of masses and springs, with its preconditioners and its eigenpairs by LAPACK."""

    def __init__(self):
        random = rng("lattice")
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in (9, 7, 5)), indexing="ij"), axis=-1)
        self.nodes = grid.reshape(-1, 3) + 0.1 * random.uniform(-1, 1, (grid.size // 3, 3))
        i, j = cKDTree(self.nodes).query_pairs(1.7, output_type="ndarray").T
        along = self.nodes[j] - self.nodes[i]
        along /= np.linalg.norm(along, axis=1)[:, None]
        rows = np.repeat(np.arange(len(i)), 3)
        stretch = sum(
            sp.csr_matrix(
                (sign * along.ravel(), (rows, (3 * end[:, None] + np.arange(3)).ravel())),
                shape=(len(i), self.nodes.size),
            )
            for sign, end in ((-1, i), (1, j))
        )
        self.stiffness = (stretch.T @ stretch).tocsr()
        self.mass = sp.diags(np.repeat(random.uniform(0.5, 2, len(self.nodes)), 3)).tocsr()
        values, vectors = scipy.linalg.eigh(self.stiffness.toarray(), self.mass.toarray())
        self.values, self.vectors = values[6 : 6 + MODES], vectors[:, 6 : 6 + BLOCK]
        shifted = self.stiffness - shift_for(self.stiffness, self.mass, self.nodes) * self.mass
        self.preconditioners = {"factorised": factorised(factorise(shifted)), "jacobi": jacobi(shifted)}

    def run(self, start, preconditioner="factorised", **options):
        return lobpcg(
            self.stiffness,
            self.mass,
            start,
            MODES,
            rigid=rigid_modes(self.nodes),
            precondition=self.preconditioners[preconditioner],
            **options,
        )


@pytest.fixture(scope="module")
def body():
    torch.set_num_threads(1)
    return Lattice()


@pytest.fixture(scope="module")
def random(body):
    return rng("start").standard_normal((len(body.vectors), BLOCK))


@pytest.fixture(scope="module")
def from_random(body, random):
    return body.run(random)


def test_it_finds_lapacks_pairs(body, from_random):
    assert from_random.converged
    np.testing.assert_allclose(from_random.values, body.values, rtol=1e-6)
    gram = from_random.vectors.T @ (body.mass @ from_random.vectors)
    np.testing.assert_allclose(gram, np.eye(MODES), atol=1e-9)
    assert abs(rigid_modes(body.nodes).T @ (body.mass @ from_random.vectors)).max() < 1e-9


def test_diagonal_blocks_find_them_in_more_iterations(body, random, from_random):
    found = body.run(random, "jacobi")
    assert found.converged
    assert found.iterations > from_random.iterations
    assert found.history.shape == (found.iterations + 1, MODES)
    np.testing.assert_allclose(found.values, body.values, rtol=1e-6)


def test_converged_columns_get_no_new_directions(from_random):
    assert from_random.applied < 0.9 * BLOCK * from_random.iterations


def test_products_with_the_matrices_do_not_drift(body, random):
    """They are carried along by the same combinations as the vectors."""
    found = body.run(random, "jacobi", tolerance=1e-9)
    assert found.converged
    true = residuals(body.stiffness, body.mass, found.values, found.vectors)
    np.testing.assert_allclose(true, found.history[-1], atol=1e-10)


def test_a_better_start_takes_fewer_iterations(body, random, from_random):
    noise = 0.1 * random / np.linalg.norm(random, axis=0) * np.linalg.norm(body.vectors, axis=0)
    found = body.run(body.vectors + noise)
    assert found.converged
    assert found.iterations < from_random.iterations
    np.testing.assert_allclose(found.values, body.values, rtol=1e-6)


def test_modes_themselves_take_no_iteration(body, from_random):
    again = body.run(from_random.vectors)
    assert again.iterations == again.applied == 0
    np.testing.assert_allclose(again.values, from_random.values, rtol=1e-10)


def test_without_iterations_it_is_rayleigh_ritz_and_bounds_hold(body, random):
    found = body.run(random, max_iterations=0)
    assert not found.converged
    assert (found.values > body.values).all()


def test_dependent_columns_and_rigid_motions_in_a_start_do_no_harm(body, random, from_random):
    start = np.concatenate([rigid_modes(body.nodes), 1e6 * random, random[:, :3]], axis=1)
    found = body.run(start)
    assert found.iterations == from_random.iterations
    np.testing.assert_allclose(found.values, from_random.values, rtol=1e-8)


def test_a_start_with_too_few_columns_is_refused(body, random):
    with pytest.raises(ValueError, match="The start spans 29 elastic directions, too few for 30 modes"):
        body.run(random[:, : MODES - 1])


def test_frequencies_of_elements_in_a_material_from_all_starts():
    """A block of 0.1 m per unit in steel."""
    pytest.importorskip("skfem", reason="scikit-fem belongs to the environment of finite elements")
    steel = MATERIALS["steel"]
    operators = assemble(*distorted_box((1.0, 0.7, 0.3), (5, 4, 2), 0.03, rng("body")), 2)
    values = solve(operators, steel["poisson"], MODES, rng=rng("pairs")).values
    expected = np.sqrt(values * 2.0e11 / 7850.0) / 0.1 / (2 * np.pi)
    iterations = {}
    for name, start in {
        "random": starts.random(operators, BLOCK, rng("random")),
        "linear": starts.linear(operators, BLOCK, steel["poisson"], rng("linear")),
        "polynomial": starts.polynomial(operators, BLOCK, steel["poisson"], 6),
    }.items():
        spectrum, found = frequencies(operators, start, steel, 0.1, modes=MODES)
        np.testing.assert_allclose(spectrum.frequencies_hz, expected, rtol=1e-6)
        assert {*spectrum.seconds} == {"preconditioner", "iteration"}
        iterations[name] = found.iterations
    assert max(iterations["linear"], iterations["polynomial"]) < iterations["random"]
