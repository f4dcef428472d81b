"""Splines on a grid of cells against exact values, elements and polynomials."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from meshes import box, distorted_box
from test_galerkin import CUBE, UNIT, surface
from vibraverse.contract.seeds import rng
from vibraverse.geometry import surfaces
from vibraverse.geometry.meshing.tets import tetrahedralise
from vibraverse.learn.baselines.polynomials import legendre_moments, polynomial_ritz
from vibraverse.learn.baselines.rods import cut_rods
from vibraverse.learn.baselines.splines import spline_modes, spline_ritz, spline_space
from vibraverse.physics.eigensolver import solve
from vibraverse.physics.elasticity import assemble
from vibraverse.physics.materials import lame


@pytest.fixture(scope="module")
def bent():
    """A bent, twisted block: its elements and its surface."""
    points, cells = distorted_box((2.0, 0.7, 0.3), (16, 6, 4), 0.01, rng("splines"))
    points[:, 2] += 0.3 * points[:, 0] ** 2
    points[:, 1] *= 1 + 0.3 * points[:, 0]
    points = points @ Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).as_matrix()
    return (points, cells), surface(points, cells)


def test_moments_of_the_parts_add_up_to_those_of_the_solid(bent):
    """Against exact moments of the whole solid: the lines alone are wrong, by less than a thousandth."""
    _, (vertices, faces) = bent
    low, sides = vertices.min(axis=0), np.ptp(vertices, axis=0)
    cells = np.array([7, 4, 3])
    rods = cut_rods((vertices - low) / sides * cells, faces, cells, 1.0)
    part, _ = rods.parts()
    found = rods.moments(part)
    volume = sides.prod() / cells.prod() * found[:, 0, 0, 0].sum()
    assert volume == pytest.approx(surfaces.volume(vertices, faces), rel=1e-3)
    # x of a point is its place in the cell and the cell's own.
    first = (found[:, 1, 0, 0] + rods.cells_of(part)[:, 0] * found[:, 0, 0, 0]).sum() / 7
    exact = legendre_moments(2 * (vertices - low) / sides - 1, faces, 2)
    assert first / cells.prod() == pytest.approx((exact[0, 0, 0] + exact[1, 0, 0]) / 16, rel=1e-3)
    assert found.min() >= 0


def test_a_cube_has_its_exact_frequencies():
    found = 2 * np.pi * spline_ritz(*surface(*box((1.0,) * 3, (1, 1, 1))), UNIT, 1.0, 3000, 17).frequencies_hz
    # Its principal axes are arbitrary, so the cells lie across its faces.
    np.testing.assert_allclose(found / np.sqrt(lame(1.0, 0.3)[1]), CUBE, rtol=3e-3)


def test_frequencies_fall_to_those_of_elements_and_polynomials(bent):
    """All bound the true ones from above: 2,304 quadratic elements by 2 %, polynomials in the low modes by less."""
    elements, shape = bent
    by_elements = np.sqrt(solve(assemble(*elements, 2), 0.3, 24, rng=rng("true")).values)
    by_polynomials = 2 * np.pi * polynomial_ritz(*shape, UNIT, 1.0, 10, 24).frequencies_hz
    found = []
    for unknowns in (600, 1500, 4000):
        space = spline_space(*shape, unknowns)
        assert 0.4 * unknowns < space.unknowns <= unknowns
        found.append(np.sqrt(spline_modes(space, [0.3], 24)[0]))
    assert (np.diff(found, axis=0) < 2e-4 * found[-1]).all()
    np.testing.assert_allclose(found[-1][:6], by_polynomials[:6], rtol=1e-3)
    assert (found[-1] < 1.0005 * np.minimum(by_elements, by_polynomials)).all()
    assert (found[-1] > 0.97 * by_elements).all()


def test_all_ratios_at_once_are_as_each_alone(bent):
    space = spline_space(*bent[1], 1500)
    ratios = np.linspace(0.1, 0.4, 5)
    together = spline_modes(space, ratios, 64)
    alone = np.array([spline_modes(space, [ratio], 64)[0] for ratio in ratios])
    np.testing.assert_allclose(np.sqrt(together / alone), 1.0, atol=3e-3)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_body_turned_moved_scaled_or_mirrored_keeps_its_frequencies(bent, mirrored):
    _, (vertices, faces) = bent
    turned = 300.0 * vertices @ Rotation.from_euler("xyz", (1.0, -0.4, 2.0)).as_matrix() + [5.0, -2.0, 1.0]
    if mirrored:
        turned, faces = turned * [1, 1, -1], faces[:, ::-1]
    first, second = (
        spline_modes(spline_space(*shape, 1000), [0.3], 40)[0] for shape in (bent[1], (turned, faces))
    )
    np.testing.assert_allclose(300.0 * np.sqrt(second / first), 1.0, rtol=1e-6)


def test_a_thin_plate_bends_as_plates_do():
    """A free square plate of Poisson's ratio 0.3: ω a² sqrt(ρ h / D) = 13.47, 19.60, 24.27 (Leissa 1969)."""
    side, height = 1.0, 0.01
    found = spline_ritz(*surface(*box((side, side, height), (1, 1, 1))), UNIT, 1.0, 2000, 3).frequencies_hz
    stiffness = height**2 / (12 * (1 - 0.3**2))
    np.testing.assert_allclose(2 * np.pi * found / np.sqrt(stiffness), [13.47, 19.60, 24.27], rtol=0.025)


def test_too_few_unknowns_are_said():
    space = spline_space(*surface(*box((1.0,) * 3, (1, 1, 1))), 100)
    with pytest.raises(ValueError, match=r"unknowns are too few for 300 modes; ask for more"):
        spline_modes(space, [0.3], 300)


def test_loose_rods_are_left_out():
    """They would move by themselves, without energy: a second rigid body."""
    bar, crumb = trimesh.creation.box((2.0, 1.0, 0.5)), trimesh.creation.box((0.02, 0.02, 0.02))
    crumb.apply_translation((0.0, 0.0, 0.6))
    both = bar + crumb
    alone, beside = (
        spline_modes(spline_space(np.array(one.vertices), np.array(one.faces), 1000), [0.3], 10)[0]
        for one in (bar, both)
    )
    np.testing.assert_allclose(np.sqrt(beside / alone), 1.0, atol=0.01)


def fork(gap: float):
    """Return a block of 2 x 1 x 0.4 with a slot of this width from one end to near the other, along y or z."""
    block, slot = trimesh.creation.box((2.0, 1.0, 0.4)), trimesh.creation.box((1.7, gap, 1.0))
    slot.apply_translation((0.2, 0.05, 0.0))
    made = trimesh.boolean.difference([block, slot], engine="manifold")
    return np.array(made.vertices), np.array(made.faces)


@pytest.mark.parametrize("gap", [0.02, 0.1])
def test_prongs_move_apart_however_narrow_their_gap(gap):
    """Against quadratic elements. Near its end splines still reach across the slot, which makes it shorter by a cell.

    Splines across all of it would raise the first frequency to four times that.
    """
    shape = fork(gap)
    tets = tetrahedralise(*shape, target_elements=4000)
    true = np.sqrt(solve(assemble(tets.points, tets.cells, 2), 0.3, 8, rng=rng("fork")).values)
    found = np.sqrt(spline_modes(spline_space(*shape, 3000), [0.3], 8)[0]) / true
    assert 0.98 < found.min() <= found.max() < 1.25
    assert np.median(found) < 1.08
