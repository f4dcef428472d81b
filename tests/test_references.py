"""The elements and the solver, on meshes without a mesher, against the frequencies of the validation."""

from __future__ import annotations

import numpy as np
import pytest

from meshes import ball, box
from vibraverse.contract.seeds import rng
from vibraverse.physics.eigensolver import solve
from vibraverse.physics.elasticity import assemble
from vibraverse.validation.bodies import BODIES
from vibraverse.validation.references import PUBLISHED, references


def hertz(body, mesh, poisson, modes, order=2):
    """Frequencies of a mesh in metres, of a body's material."""
    omega = np.sqrt(solve(assemble(*mesh, order), poisson, modes, rng=rng("test")).values)
    return omega * np.sqrt(body.young_pa / body.density_kg_m3) / (2 * np.pi)


def known(body, poisson, modes):
    """The body's computed frequencies, each as often as it occurs."""
    lines = [line for line in references(body, poisson) if not line.published]
    return np.concatenate([[line.hz] * line.count for line in lines])[:modes]


@pytest.fixture(scope="module")
def sphere():
    (radius,) = BODIES["ball"].lengths_m
    return ball(radius, 0.28 * radius)


@pytest.mark.parametrize("poisson", BODIES["ball"].poissons)
def test_sphere(sphere, poisson):
    body = BODIES["ball"]
    found = hertz(body, sphere, poisson, 45)
    assert found == pytest.approx(known(body, poisson, 45), rel=0.01)
    # The first two multiplets are clusters of five, well apart.
    for first in (0, 5):
        assert np.ptp(found[first : first + 5]) < 0.004 * found[first]


def test_cube():
    body = BODIES["cube"]
    assert hertz(body, box(body.lengths_m, (7, 7, 7)), 0.3, 17) == pytest.approx(
        known(body, 0.3, 17), rel=0.01
    )


def test_linear_elements_come_from_above():
    body = BODIES["cube"]
    coarse, fine = (hertz(body, box(body.lengths_m, (n, n, n)), 0.3, 17, order=1) for n in (6, 9))
    assert (coarse > fine).all()
    assert (fine > known(body, 0.3, 17) * 0.9999).all()
    assert fine == pytest.approx(known(body, 0.3, 17), rel=0.1)


def test_measured_block():
    body = BODIES["block"]
    found = hertz(body, box(body.lengths_m, (6, 6, 6)), *body.poissons, 12)
    assert found == pytest.approx(PUBLISHED["block"].hz, rel=0.01)
    assert found == pytest.approx(known(body, *body.poissons, 12), rel=0.005)


def test_free_bar():
    body = BODIES["bar"]
    found = hertz(body, box(body.lengths_m, (30, 3, 3)), 0.3, 10)
    assert found == pytest.approx(known(body, 0.3, 10), rel=0.01)


def test_linear_elements_lock_on_a_thin_bar():
    body = BODIES["bar"]
    mesh = box(body.lengths_m, (30, 1, 1))
    assert hertz(body, mesh, 0.3, 4, order=1)[0] > 1.5 * hertz(body, mesh, 0.3, 4)[0]


def test_free_plate():
    body = BODIES["plate"]
    found = hertz(body, box(body.lengths_m, (28, 28, 1)), 0.3, 6)
    assert found == pytest.approx(PUBLISHED["plate"].hz, rel=0.01)
    assert found == pytest.approx(known(body, 0.3, 6), rel=0.01)
