"""Mechanical baselines against exact values, references and each other."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes import box, distorted_box
from vibraverse.contract.seeds import rng
from vibraverse.geometry.boundary import boundary
from vibraverse.learn.baselines import elements, starts
from vibraverse.learn.baselines.galerkin import from_fields, ritz
from vibraverse.learn.baselines.polynomials import polynomial_ritz, polynomial_space
from vibraverse.physics.eigensolver import solve
from vibraverse.physics.elasticity import assemble, rigid_modes
from vibraverse.physics.materials import MATERIALS, lame

POISSON = 0.3
UNIT = {"young_pa": 1.0, "density_kg_m3": 1.0, "poisson": POISSON}
#: ``ω L / c_s`` of a cube for ν = 0.3, with multiplicities.
CUBE = np.repeat([2.8561, 3.8460, 3.9113, 4.4429, 4.5728, 4.7926], [2, 3, 3, 3, 3, 3])


def surface(points, cells):
    faces, used = boundary(cells)
    return points[used], faces


@pytest.fixture(scope="module")
def irregular():
    """A body without symmetry: a bent, twisted block."""
    points, cells = distorted_box((1.0, 0.7, 0.4), (4, 3, 2), 0.03, rng("galerkin"))
    points[:, 2] += 0.3 * points[:, 0] ** 2
    points[:, 1] *= 1 + 0.5 * points[:, 0]
    return points @ Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).as_matrix(), cells


@pytest.fixture(scope="module")
def operators(irregular):
    return assemble(*irregular, 2)


@pytest.fixture(scope="module")
def pairs(operators):
    return solve(operators, POISSON, 64, rng=rng("pairs"), tolerance=1e-8)


def test_linear_displacements_of_a_cube_have_their_exact_energy():
    """Five isochoric strains with ω² = 24 μ / L² and the dilatation with 12 (3 λ + 2 μ) / L²."""
    side, (lam, mu) = 1.7, lame(1.0, POISSON)
    values, _ = polynomial_space(*surface(*box((side,) * 3, (1, 1, 1))), 1).modes(POISSON, 6)
    exact = np.array([24 * mu] * 5 + [12 * (3 * lam + 2 * mu)]) / side**2
    np.testing.assert_allclose(values, exact, rtol=1e-13)


def test_quadratic_polynomials_give_what_quadratic_elements_give(irregular, operators):
    """The surface integrals against the assembled matrices: quadratic elements contain quadratic polynomials."""
    x = operators.nodes
    quadratic = [x[:, a] * x[:, b] for a in range(3) for b in range(a, 3)]
    scalars = np.stack([np.ones(len(x)), *x.T, *quadratic], axis=1)
    stiffness = operators.stiffness(*lame(1.0, POISSON))
    expected, _, _ = ritz(stiffness, operators.mass, np.kron(scalars, np.eye(3)), 24, rigid_modes(x))
    space = polynomial_space(*surface(*irregular), 2)
    values, vectors = space.modes(POISSON, 24)
    np.testing.assert_allclose(values, expected, rtol=1e-10)
    fields = space.fields(x, vectors)
    np.testing.assert_allclose(fields.T @ (operators.mass @ fields), np.eye(24), atol=1e-10)
    np.testing.assert_allclose(np.diag(fields.T @ (stiffness @ fields)), values, rtol=1e-10)
    assert abs(rigid_modes(x).T @ (operators.mass @ fields)).max() < 1e-10


def test_polynomials_converge_from_above_to_a_cubes_frequencies():
    shape = surface(*box((1.0,) * 3, (1, 1, 1)))
    speed = np.sqrt(lame(1.0, POISSON)[1])
    by_degree = [
        2 * np.pi * polynomial_ritz(*shape, UNIT, 1.0, degree).frequencies_hz / speed for degree in (4, 6, 8)
    ]
    for higher, lower in pairwise(by_degree):
        assert (lower <= higher * (1 + 1e-12)).all()
    assert [spectrum.shape for spectrum in by_degree] == [(64,)] * 3
    np.testing.assert_allclose(by_degree[-1][: len(CUBE)], CUBE, rtol=1.5e-3)
    # The references have four decimals.
    assert (by_degree[-1][: len(CUBE)] > CUBE - 6e-5).all()


def test_polynomials_bound_the_bending_of_a_slender_bar():
    bar = {"young_pa": 200e9, "density_kg_m3": 8000.0, "poisson": 0.3}
    found = polynomial_ritz(*surface(*box((1.0, 0.05, 0.05), (1, 1, 1))), bar, 1.0, 8).frequencies_hz
    expected = np.repeat([254.7, 691.2, 1325.6], 2)
    assert (found[:6] > expected * (1 - 3e-4)).all()
    np.testing.assert_allclose(found[:4], expected[:4], rtol=3e-3)


def test_polynomials_do_not_see_the_axes(irregular):
    vertices, faces = surface(*irregular)
    turned = vertices @ Rotation.from_euler("xyz", (1.0, -0.4, 2.0)).as_matrix() + (3.0, -2.0, 1.0)
    straight, rotated = (
        polynomial_ritz(shape, faces, UNIT, 1.0, 6).frequencies_hz for shape in (vertices, turned)
    )
    np.testing.assert_allclose(rotated, straight, rtol=1e-8)


def test_cavities_are_no_part_of_the_body(operators):
    """A box in a box: the polynomials' mass and stiffness are those of the difference."""
    outer, inner = (surface(*box((side,) * 3, (1, 1, 1))) for side in (2.0, 1.0))
    vertices = np.concatenate([outer[0] - 1.0, inner[0] - 0.5])
    faces = np.concatenate([outer[1], inner[1][:, ::-1] + len(outer[0])])
    _, mu = lame(1.0, POISSON)
    # Shear u = (y, x, 0): energy 4 μ V over ∫ x² + y² dV = (32 - 1) / 6.
    values, _ = polynomial_space(vertices, faces, 1).modes(POISSON, 1)
    np.testing.assert_allclose(values, 4 * mu * (8 - 1) / ((32 - 1) / 6), rtol=1e-12)


def test_ritz_values_bound_the_eigenvalues(operators, pairs):
    stiffness = operators.stiffness(*lame(1.0, POISSON))
    fields = starts.random(operators, 150, rng("fields"))
    values, _, _ = ritz(stiffness, operators.mass, fields, 64, rigid_modes(operators.nodes))
    assert (values >= pairs.values).all()


def test_ritz_finds_modes_among_copies_scales_and_rigid_motions(operators, pairs):
    """Fields as a network may give them: mixed, dependent, of any size, with rigid motions in them."""
    random, rigid = rng("mixing"), rigid_modes(operators.nodes)
    mixed = pairs.vectors @ random.standard_normal((64, 64)) + rigid @ random.standard_normal((6, 64))
    fields = np.concatenate([rigid, 1e9 * mixed, 1e-9 * mixed[:, :5], np.zeros((len(rigid), 1))], axis=1)
    stiffness = operators.stiffness(*lame(1.0, POISSON))
    values, vectors, residuals = ritz(stiffness, operators.mass, fields, 64, rigid)
    np.testing.assert_allclose(values, pairs.values, rtol=1e-7)
    np.testing.assert_allclose(vectors.T @ (operators.mass @ vectors), np.eye(64), atol=1e-10)
    assert residuals.max() < 1e-4
    with pytest.raises(ValueError, match=r"The 76 fields span 64 elastic directions, too few for 65 modes"):
        ritz(stiffness, operators.mass, fields, 65, rigid)


@pytest.mark.parametrize("degree", [None, 4])
def test_twice_the_stiffness_is_root_two_of_the_frequency(irregular, operators, degree):
    fields = starts.random(operators, 80, rng("fields"))
    steel = MATERIALS["steel"]
    stiffer = {**steel, "young_pa": 2 * steel["young_pa"]}
    one, two = (
        from_fields(operators, fields, material, 0.1)
        if degree is None
        else polynomial_ritz(*surface(*irregular), material, 0.1, degree)
        for material in (steel, stiffer)
    )
    np.testing.assert_allclose(two.frequencies_hz, np.sqrt(2) * one.frequencies_hz, rtol=1e-14)
    assert one.total_seconds == sum(one.seconds.values()) > 0


def test_a_linear_start_holds_the_modes_of_linear_elements(irregular, operators):
    """Linear elements lie in the space of quadratic ones, so their modes keep their values there."""
    values = solve(assemble(*irregular, 1), POISSON, 20, rng=rng("linear"), tolerance=1e-8).values
    stiffness = operators.stiffness(*lame(1.0, POISSON))
    start = starts.linear(operators, 20, POISSON, rng("start"))
    found, _, _ = ritz(stiffness, operators.mass, start, 20, rigid_modes(operators.nodes))
    np.testing.assert_allclose(found, values, rtol=1e-6)


def test_a_polynomial_start_holds_upper_bounds_near_the_first_modes(operators, pairs):
    stiffness = operators.stiffness(*lame(1.0, POISSON))
    start = starts.polynomial(operators, 70, POISSON, degree=6)
    found, _, _ = ritz(stiffness, operators.mass, start, 64, rigid_modes(operators.nodes))
    assert (found >= pairs.values * (1 - 1e-9)).all()
    assert found[0] < 1.1 * pairs.values[0]


def test_arpack_and_the_modal_basis_agree(irregular):
    by_arpack = elements.arpack(*irregular, MATERIALS["glass"], 0.1, rng=rng("arpack"))
    by_basis = elements.modal_basis(
        *irregular, MATERIALS["glass"], 0.1, rng=rng("basis"), corrected=False, poisson_range=(0.15, 0.25)
    )
    np.testing.assert_allclose(by_basis.frequencies_hz, by_arpack.frequencies_hz, rtol=2e-5)
    assert {*by_arpack.seconds} == {"assembly", "eigensolver"}


def test_few_corrected_quadratic_elements_are_accurate_and_linear_ones_are_not():
    shape = surface(*box((1.0,) * 3, (3, 3, 3)))
    speed = np.sqrt(lame(1.0, POISSON)[1])
    quadratic, linear = (
        2
        * np.pi
        * elements.coarse(*shape, UNIT, 1.0, rng=rng("coarse"), elements=300, **kind).frequencies_hz
        / speed
        for kind in ({}, {"order": 1, "corrected": False})
    )
    np.testing.assert_allclose(quadratic[: len(CUBE)], CUBE, rtol=5e-3)
    assert (linear[: len(CUBE)] > 1.01 * CUBE).all()
