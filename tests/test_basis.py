"""Operators and the modal basis."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes import box, distorted_box
from vibraverse.contract.errors import Refused
from vibraverse.contract.seeds import rng
from vibraverse.files.basis import read_basis, write_basis
from vibraverse.geometry.boundary import boundary
from vibraverse.physics.basis import build_basis, rigid_body
from vibraverse.physics.eigensolver import solve
from vibraverse.physics.elasticity import assemble, rigid_modes
from vibraverse.physics.materials import lame
from vibraverse.physics.modes import reduced_solve
from vibraverse.physics.reduction import Reduction

SIDES = (1.0, 0.8, 0.5)


@pytest.fixture(scope="module")
def mesh():
    return distorted_box(SIDES, (5, 4, 3), 0.03, rng("test"))


@pytest.fixture(scope="module", params=[1, 2])
def operators(mesh, request):
    return assemble(*mesh, request.param)


def test_matrices_equal_scikit_fems(mesh, operators):
    """The contraction against scikit-fem's own form-by-form assembly, on random displacement fields."""
    from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector, MeshTet
    from skfem.helpers import ddot, div, dot, sym_grad

    element = ElementVector({1: ElementTetP1, 2: ElementTetP2}[operators.order]())
    basis = Basis(MeshTet(mesh[0].T, mesh[1].T), element, intorder=2 * operators.order)
    forms = {
        "k_lambda": BilinearForm(lambda u, v, w: div(u) * div(v)),
        "k_mu": BilinearForm(lambda u, v, w: 2 * ddot(sym_grad(u), sym_grad(v))),
        "mass": BilinearForm(lambda u, v, w: dot(u, v)),
    }
    # scikit-fem numbers unknowns in another order; match them by place and component.
    component = np.array([int(name[-1]) - 1 for name in _component_names(basis)])
    order = np.lexsort((component, *basis.doflocs.round(9)))
    ours = np.lexsort(
        (np.tile([0, 1, 2], len(operators.nodes)), *np.repeat(operators.nodes, 3, axis=0).T.round(9))
    )
    for name, form in forms.items():
        theirs = form.assemble(basis).tocsr()[order][:, order]
        mine = getattr(operators, name)[ours][:, ours]
        assert abs(theirs - mine).max() <= 1e-12 * abs(theirs).max(), name


def _component_names(basis):
    """The name u^1, u^2 or u^3 of every unknown of a vector basis."""
    names = np.empty(basis.N, dtype=object)
    for row, name in zip(basis.nodal_dofs, basis.elem.dofnames, strict=False):
        names[row] = name
    for row, name in zip(basis.edge_dofs, basis.elem.dofnames[len(basis.nodal_dofs) :], strict=False):
        names[row] = name
    return names


def test_rigid_motions_cost_no_energy(operators):
    rigid = rigid_modes(operators.nodes)
    scale = abs(operators.k_mu).max()
    assert abs(operators.k_lambda @ rigid).max() < 1e-12 * scale
    assert abs(operators.k_mu @ rigid).max() < 1e-12 * scale


def test_total_mass_centre_and_inertia(operators):
    volume, centre, inertia = rigid_body(operators)
    a, b, c = SIDES
    assert operators.volume == pytest.approx(a * b * c, rel=1e-12)
    assert volume == pytest.approx(a * b * c, rel=1e-12)
    assert centre == pytest.approx(np.array(SIDES) / 2, rel=1e-12)
    if operators.order == 2:
        expected = volume / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
        assert inertia == pytest.approx(expected, abs=1e-12)


def test_symmetry(operators):
    for matrix in (operators.k_lambda, operators.k_mu, operators.mass):
        assert abs(matrix - matrix.T).max() <= 1e-15 * abs(matrix).max() * 10


def test_unchanged_by_rotation_mirroring_and_numbering(mesh):
    points, cells = mesh
    reference = solve(assemble(points, cells), 0.25, 20, rng=rng("a")).values
    turned = points @ Rotation.from_euler("xyz", [0.3, -1.1, 2.0]).as_matrix().T + [3.0, -2.0, 5.0]
    mirrored = points * [-1, 1, 1], cells[:, [1, 0, 2, 3]]
    shuffle = rng("shuffle").permutation(len(points))
    shuffled = points[shuffle], np.argsort(shuffle)[cells][::-1]
    for other in ((turned, cells), mirrored, shuffled):
        assert solve(assemble(*other), 0.25, 20, rng=rng("b")).values == pytest.approx(reference, rel=1e-8)


def test_frequencies_fall_as_the_mesh_is_refined():
    coarse, fine = (
        solve(assemble(*box(SIDES, n)), 0.3, 12, rng=rng("a")).values for n in ((3, 3, 2), (6, 6, 4))
    )
    assert (fine < coarse * (1 + 1e-12)).all()


@pytest.fixture(scope="module")
def basis(mesh):
    return build_basis(*mesh, rng=rng("test", "solid", "basis"), modes=40)


def test_basis_gives_the_frequencies_of_every_poisson_ratio(mesh, basis):
    from vibraverse.physics.modes import reduced_solve

    operators = assemble(*mesh)
    assert basis.error <= 1e-5
    for poisson in (0.1, 0.12, 0.15, 0.19, 0.25, 0.28, 0.35, 0.37, 0.4):
        exact = solve(operators, poisson, 40, rng=rng("c"), method="dense").values
        reduced = reduced_solve(basis, poisson, 40, corrected=False)
        estimate, true = reduced.relative_error, np.sqrt(reduced.values / exact) - 1
        # Rayleigh–Ritz comes from above; the stated error covers the true one, give or take its randomness.
        assert true.min() > -1e-8  # LAPACK's own rounding
        assert true.max() < 1e-5
        assert estimate.max() < 2e-5
        assert (estimate[true > 1e-7] > 0.3 * true[true > 1e-7]).all()


def test_wider_ranges_and_smaller_errors_take_more_vectors(mesh, basis):
    from vibraverse.physics.modes import reduced_solve

    wide = build_basis(*mesh, rng=rng("w"), modes=40, poisson_range=(0.0, 0.49), max_error=1e-7)
    assert wide.error <= 1e-7
    assert len(wide.a_mu) > len(basis.a_mu)
    exact = solve(assemble(*mesh), 0.48, 40, rng=rng("c"), method="dense").values
    assert np.abs(np.sqrt(reduced_solve(wide, 0.48, 40, corrected=False).values / exact) - 1).max() < 1e-7
    single = build_basis(*mesh, rng=rng("w"), modes=40, poisson_range=(0.3, 0.3))
    assert single.poisson_nodes[0] == 0.3
    assert len(single.a_mu) < len(basis.a_mu)


def test_error_outside_the_range_is_stated(mesh, basis):
    from vibraverse.physics.modes import reduced_solve

    exact = solve(assemble(*mesh), 0.48, 40, rng=rng("c"), method="dense").values
    reduced = reduced_solve(basis, 0.48, 40, corrected=False)
    estimate, true = reduced.relative_error, np.sqrt(reduced.values / exact) - 1
    assert true.max() > 1e-4
    assert (estimate[true > 1e-6] > 0.3 * true[true > 1e-6]).all()


@pytest.mark.parametrize("factorisation", ["pardiso", "superlu"])
def test_basis_on_either_factorisation(mesh, basis, factorisation):
    from vibraverse.physics.modes import reduced_solve

    other = build_basis(*mesh, rng=rng("f"), modes=40, method="lanczos", factorisation=factorisation)
    assert other.factorisation == factorisation
    for corrected, tolerance in ((False, 4e-5), (True, 3e-4)):
        expected = reduced_solve(basis, 0.33, 40, corrected).values
        assert reduced_solve(other, 0.33, 40, corrected).values == pytest.approx(expected, rel=tolerance)


def test_basis_does_not_depend_on_the_run(mesh, basis):
    again = build_basis(*mesh, rng=rng("test", "solid", "basis"), modes=40)
    assert np.array_equal(again.a_mu, basis.a_mu)
    assert np.array_equal(again.surface, basis.surface)


def test_basis_file_round_trip(basis, tmp_path):
    import h5py

    with h5py.File(tmp_path / "basis.h5", "w") as h5:
        write_basis(h5, basis)
    with h5py.File(tmp_path / "basis.h5") as h5:
        again = read_basis(h5)
    for field in dataclasses.fields(basis):
        value = getattr(basis, field.name)
        if field.name in ("surface", "correction_surface"):
            value = value.astype("f4")
        assert np.array_equal(getattr(again, field.name), value), field.name


def test_boundary_is_closed_and_outward(mesh):
    faces, nodes = boundary(mesh[1])
    corners = mesh[0][nodes][faces]
    volume = np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert volume == pytest.approx(np.prod(SIDES), rel=1e-12)


def test_inverted_and_flat_elements_are_refused(mesh):
    points, cells = mesh
    inverted = cells.copy()
    inverted[3] = inverted[3, [1, 0, 2, 3]]
    with pytest.raises(Refused, match=r"1 of .* tetrahedra have zero or negative volume"):
        assemble(points, inverted)
    flat = points.copy()
    flat[:, 2] = 0
    with pytest.raises(Refused, match="zero or negative volume"):
        assemble(flat, cells)


def test_two_bodies_are_refused(mesh):
    points, cells = mesh
    two = np.concatenate([points, points + [5, 0, 0]]), np.concatenate([cells, cells + len(points)])
    with pytest.raises(Refused, match="not one connected body"):
        build_basis(*two, rng=rng("x"), modes=10)


def test_too_few_unknowns_are_refused(mesh):
    points, cells = mesh
    one = cells[:1]
    with pytest.raises(Refused, match="too few for 64 elastic"):
        build_basis(points, one, rng=rng("x"))


@pytest.mark.parametrize("outside", [1.0, 1e-2, 1e-4, 1e-6])
def test_a_space_that_grows_has_an_orthonormal_basis(outside):
    """However small the part of the new vectors outside the space or along one of its directions."""
    operators = assemble(*box((1.8, 1.2, 0.7), (3, 2, 2)))
    random = rng("t", "growth")
    start = random.standard_normal((operators.unknowns, 6))
    space = Reduction(operators, start)
    fresh = random.standard_normal((operators.unknowns, 4))
    fresh[:, 3] = fresh[:, 2] + outside * fresh[:, 3]
    space.join(start[:, :4] + outside * fresh)
    basis = space.vectors @ space.in_vectors(np.eye(10))
    assert basis.T @ (operators.mass @ basis) == pytest.approx(np.eye(10), abs=1e-9)
    for projected, matrix in ((space.a_lambda, operators.k_lambda), (space.a_mu, operators.k_mu)):
        expected = basis.T @ (matrix @ basis)
        assert projected == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    # All that joined is in it, and no rigid motion.
    rigid = rigid_modes(operators.nodes)
    assert basis.T @ (operators.mass @ rigid) == pytest.approx(np.zeros((10, 6)), abs=1e-9)


@pytest.mark.parametrize("max_error", [1e-9, 8.0])
def test_corrections_are_projected_without_a_product_with_k_mu(max_error):
    """The result from residuals equals that of the product, for all or some directions of a correction."""
    operators = assemble(*box((1.8, 1.2, 0.7), (5, 4, 3)))
    pairs = solve(operators, 0.25, 12, rng=rng("t"), method="lanczos")
    space = Reduction(operators, pairs.vectors)
    factor = pairs.factor
    for at, toward in ((0.25, 0.4), (0.45, 0.49)):
        factor.update(operators.shifted(*lame(1.0, at), pairs.shift))
        space.use(factor, at, pairs.shift, rng("probes"))
        values, coefficients, _ = space.solve(toward, 8, 2)
        rank = len(space.a_mu)
        space.correct(toward, values, coefficients, max_error)
        assert (len(space.a_mu) < rank + 10) == (max_error == 8.0)
    basis = space.vectors @ space.in_vectors(np.eye(len(space.a_mu)))
    for projected, matrix in ((space.a_lambda, operators.k_lambda), (space.a_mu, operators.k_mu)):
        expected = basis.T @ (matrix @ basis)
        assert projected == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("sides", "cells", "modes"), [((1.8, 0.5, 0.5), (8, 2, 2), 40), ((1.8, 1.2, 1.2), (5, 4, 4), 24)]
)
def test_no_frequency_is_forgotten_between_the_values_looked_at(sides, cells, modes):
    """A mode is among the lowest only in a part of the range; errors were fifty times too large there."""
    basis = build_basis(*box(sides, cells), rng=rng("t"), modes=modes)
    for poisson in np.linspace(0.1, 0.4, 121):
        assert reduced_solve(basis, poisson, modes).relative_error.max() < 1.2e-5, poisson
