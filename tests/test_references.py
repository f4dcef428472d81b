"""The solver against numbers that others computed or measured."""

from __future__ import annotations

import numpy as np
import pytest

from meshes import ball, box
from vibraverse.physics.eigensolver import solve
from vibraverse.physics.elasticity import assemble, lame
from vibraverse.seeds import rng


def omega(mesh, poisson, modes, order=2):
    """Angular frequencies for E = ρ = 1."""
    return np.sqrt(solve(assemble(*mesh, order), poisson, modes, rng=rng("test")).values)


def shear_speed(poisson):
    return np.sqrt(lame(1.0, poisson)[1])


#: ω a / c_s of the free sphere: T2 five times, S2 five times, … (Lamb's solutions).
SPHERE = {
    0.20: {"S2": 2.63270, "S0": 4.01804},
    0.25: {"S2": 2.63987, "S0": 4.44000},
    0.30: {"S2": 2.64622, "S0": 4.99551},
    0.35: {"S2": 2.65187, "S0": 5.78948},
}


@pytest.fixture(scope="module")
def sphere():
    return ball(1.0, 0.28)


@pytest.mark.parametrize("poisson", SPHERE)
def test_sphere(sphere, poisson):
    found = omega(sphere, poisson, 45) / shear_speed(poisson)
    assert found[:5] == pytest.approx(2.50113, rel=0.01)
    assert found[5:10] == pytest.approx(SPHERE[poisson]["S2"], rel=0.01)
    # Each multiplet is one cluster, well apart from the next.
    assert np.ptp(found[:5]) < 0.01
    assert np.ptp(found[5:10]) < 0.01
    # T3 sevenfold and the breathing mode S0 lie where they must.
    assert (abs(found / 3.86470 - 1) < 0.01).sum() >= 7
    if SPHERE[poisson]["S0"] < found[-1]:
        assert abs(found / SPHERE[poisson]["S0"] - 1).min() < 0.01


CUBE = np.repeat([2.8561, 3.8460, 3.9113, 4.4429, 4.5728, 4.7926], [2, 3, 3, 3, 3, 3])


def test_cube():
    found = omega(box((1, 1, 1), (7, 7, 7)), 0.3, 17) / shear_speed(0.3)
    assert found == pytest.approx(CUBE, rel=0.01)


def test_linear_elements_come_from_above():
    coarse = omega(box((1, 1, 1), (6, 6, 6)), 0.3, 17, order=1) / shear_speed(0.3)
    fine = omega(box((1, 1, 1), (9, 9, 9)), 0.3, 17, order=1) / shear_speed(0.3)
    assert (coarse > fine).all()
    assert (fine > CUBE * 0.9999).all()
    assert fine == pytest.approx(CUBE, rel=0.1)


def test_measured_block():
    """An aluminium block measured by resonant ultrasound: Ogi et al., J. Acoust. Soc. Am. 112, 2553 (2002)."""
    c11, c44, density = 109.26e9, 26.72e9, 2788.0
    measured_khz = [
        116.716, 143.783, 158.081, 166.5, 169.523, 177.846,
        183.875, 186.047, 190.341, 197.386, 201.133, 207.386,
    ]  # fmt: skip
    lam = c11 - 2 * c44
    poisson = lam / (2 * (lam + c44))
    young = 2 * c44 * (1 + poisson)
    found = omega(box((11.92e-3, 10.93e-3, 9.86e-3), (6, 6, 6)), poisson, 12) * np.sqrt(young / density)
    assert found / (2e3 * np.pi) == pytest.approx(measured_khz, rel=0.01)


def test_free_bar():
    found = omega(box((1, 0.05, 0.05), (30, 2, 2)), 0.3, 12) * np.sqrt(200e9 / 8000) / (2 * np.pi)
    for frequency in (254.7, 691.2, 1325.6):
        pair = found[np.argsort(abs(found - frequency))[:2]]
        assert pair == pytest.approx(frequency, rel=0.01)


def test_linear_elements_lock_on_a_thin_bar():
    mesh = box((1, 0.05, 0.05), (30, 1, 1))
    assert omega(mesh, 0.3, 4, order=1)[0] > 1.5 * omega(mesh, 0.3, 4)[0]


def test_free_plate():
    """NAFEMS FV12: a free thin square plate."""
    found = omega(box((10, 10, 0.05), (28, 28, 1)), 0.3, 6) * np.sqrt(200e9 / 8000) / (2 * np.pi)
    assert found == pytest.approx([1.622, 2.360, 2.922, 4.233, 4.233, 7.416], rel=0.01)
