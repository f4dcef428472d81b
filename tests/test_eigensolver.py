"""Eigensolvers and factorisations: every method finds every pair, and a pair that it misses is noticed."""

from __future__ import annotations

import numpy as np
import pytest

from meshes import box, distorted_box
from vibraverse.contract.errors import Refused
from vibraverse.contract.seeds import rng
from vibraverse.physics.columns import residuals
from vibraverse.physics.eigensolver import RIGID, count_below, solve
from vibraverse.physics.elasticity import assemble
from vibraverse.physics.factorisation import factorise
from vibraverse.physics.iterations import gap
from vibraverse.physics.materials import lame

POISSON = 0.3


@pytest.fixture(scope="module")
def operators():
    """Those of a brick no element of which is like another, and so no eigenvalue multiple."""
    return assemble(*distorted_box((1.0, 0.8, 0.5), (3, 3, 2), 0.03, rng("test")))


@pytest.fixture(scope="module")
def exact(operators):
    return solve(operators, POISSON, 40, rng=rng("a"), method="dense")


@pytest.fixture(scope="module")
def cube():
    return assemble(*box((1, 1, 1), (3, 3, 3)))


@pytest.mark.parametrize("factorisation", ["pardiso", "superlu"])
@pytest.mark.parametrize("method", ["lanczos", "arpack", "lobpcg"])
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6])
def test_methods_agree_with_lapack(operators, exact, method, factorisation, tolerance):
    found = solve(
        operators, POISSON, 20, rng=rng("a"), method=method, factorisation=factorisation, tolerance=tolerance
    )
    assert found.values == pytest.approx(exact.values[:20], rel=10 * tolerance**2 + 1e-11)
    gram = found.vectors.T @ (operators.mass @ found.vectors)
    assert abs(gram - np.eye(20)).max() < 1e-10
    # The residuals are what they are said to be, below the tolerance.
    stiffness = operators.stiffness(*lame(1.0, POISSON))
    measured = residuals(stiffness, operators.mass, found.values, found.vectors)
    assert found.residuals == pytest.approx(measured, rel=1e-3, abs=1e-10)
    assert found.residuals.max() <= tolerance
    assert (found.method, found.attempts) == (method, 1)
    assert found.solves >= 20
    assert found.seconds > 0
    assert found.gap == pytest.approx(exact.values[20] / exact.values[19] - 1, rel=0.01)


def test_order_one_too():
    operators = assemble(*box((1, 0.8, 0.5), (6, 5, 4)), order=1)
    exact = solve(operators, POISSON, 20, rng=rng("a"), method="dense")
    for method in ("lanczos", "arpack", "lobpcg"):
        found = solve(operators, POISSON, 20, rng=rng("a"), method=method)
        assert found.values == pytest.approx(exact.values, rel=1e-8)


@pytest.mark.parametrize("method", ["lanczos", "arpack"])
def test_residuals_of_thin_bodies(method):
    """Rounding is large: without a final solve, the lowest modes' residuals would be a hundred times the tolerance."""
    found = solve(
        assemble(*box((10, 10, 0.05), (10, 10, 1))), POISSON, 20, rng=rng("a"), method=method, tolerance=3e-6
    )
    assert found.residuals.max() <= 3e-6
    assert found.gap > 1e-4


class Blind(np.random.Generator):
    """Random start vectors without any part of one mode, so that an iteration from them cannot find it."""

    def __init__(self, vector, weighted):
        super().__init__(np.random.PCG64(1))
        self._vector, self._weighted, self.blind = vector, weighted, True

    def standard_normal(self, size):
        noise = super().standard_normal(size)
        if self.blind:
            self.blind = False
            noise -= (self._vector * (self._weighted @ noise).T[..., None]).T
        return noise


@pytest.mark.parametrize("factorisation", ["pardiso", "superlu"])
def test_a_mode_that_is_missed_is_noticed_and_found(operators, exact, factorisation):
    lost = exact.vectors[:, 12]
    start = Blind(lost, operators.mass @ lost)
    found = solve(
        operators, POISSON, 20, rng=start, method="lanczos", factorisation=factorisation, tolerance=1e-4
    )
    assert found.attempts == 2
    assert found.values == pytest.approx(exact.values[:20], rel=1e-7)


def test_modes_that_stay_missed_are_refused(operators, exact):
    class AlwaysBlind(Blind):
        def standard_normal(self, size):
            self.blind = True
            return super().standard_normal(size)

    lost = exact.vectors[:, 12]
    start = AlwaysBlind(lost, operators.mass @ lost)
    with pytest.raises(Refused, match="wrong by 1"):
        solve(operators, POISSON, 20, rng=start, method="lanczos", tolerance=1e-4)


@pytest.mark.parametrize("factorisation", ["pardiso", "superlu"])
def test_inertia_counts_the_modes(operators, exact, factorisation):
    for below in (0, 5, 30):
        cut = 0.5 * (exact.values[below - 1] + exact.values[below]) if below else 0.5 * exact.values[0]
        count = count_below(operators, POISSON, cut, exact.vectors[:, below : below + 2], factorisation)
        assert count == RIGID + below


@pytest.mark.parametrize("factorisation", ["pardiso", "superlu"])
def test_a_count_in_doubt_is_refused(operators, exact, factorisation):
    """If an eigenvalue lies on the cut, its side is decided by rounding."""
    with pytest.raises(Refused, match="too many digits"):
        count_below(
            operators, POISSON, exact.values[12] * (1 + 1e-14), exact.vectors[:, 12:13], factorisation
        )


def test_multiplets_come_out_whole_or_are_said_to_be_cut(cube):
    """This mesh of a cube has doublets, the first two among them; all are found, and a cut through one is seen."""
    exact = solve(cube, POISSON, 40, rng=rng("b"), method="dense").values
    assert (np.diff(exact) < 1e-9 * exact[1:]).sum() > 10
    for modes in (1, 2, 39):
        found = solve(cube, POISSON, modes, rng=rng("b"), method="lanczos")
        assert found.values == pytest.approx(exact[:modes], rel=1e-8)
        assert found.attempts == 1
        assert found.gap == pytest.approx(exact[modes] / exact[modes - 1] - 1, rel=0.01, abs=1e-6)
    assert solve(cube, POISSON, 1, rng=rng("b"), method="lanczos").gap < 1e-6


def test_the_gap_beyond_the_pairs_wanted():
    values = np.array([1.0, 2.0, 3.0, 3.0000001, 3.0000002, 4.0])
    assert gap(values, 2) == (2, pytest.approx(0.5))
    assert gap(values, 3) == (5, pytest.approx(1 / 3, rel=1e-6))
    # Where no gap is wide, the widest.
    assert gap(np.array([1.0, 1.0 + 1e-9, 1.0 + 1e-6, 1.0 + 1.1e-6]), 1)[0] == 2


@pytest.mark.parametrize("factorisation", ["pardiso", "superlu"])
def test_inverse_root(operators, factorisation):
    matrix = operators.shifted(*lame(1.0, POISSON), -5.0)
    root = factorise(matrix, factorisation).inverse_root(np.eye(operators.unknowns))
    assert abs(matrix @ (root @ root.T) - np.eye(operators.unknowns)).max() < 1e-9
