"""Scale-free invariants of bodies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes import box
from vibraverse.geometry.boundary import boundary
from vibraverse.learn.invariants import INVARIANTS, invariants, thinness


def block(sides, divisions=(2, 2, 2)):
    points, cells = box(sides, divisions)
    faces, used = boundary(cells)
    return points[used], faces


def test_a_block_has_the_invariants_of_the_formula():
    a, b, c = sides = (0.5, 1.0, 2.0)
    found = dict(zip(INVARIANTS, invariants(*block(sides)), strict=True))
    volume = a * b * c
    for name, side in zip(("spread_low", "spread_middle", "spread_high"), sides, strict=True):
        assert found[name] == pytest.approx(volume * side**2 / 12 / volume ** (5 / 3))
    assert found["area"] == pytest.approx(2 * (a * b + b * c + c * a) / volume ** (2 / 3))
    assert found["reach"] == pytest.approx(0.5 * np.linalg.norm(sides) / volume ** (1 / 3))
    expected = 2 * volume / (2 * (a * b + b * c + c * a)) / np.linalg.norm(sides)
    assert thinness(invariants(*block(sides))[None])[0] == pytest.approx(expected)


def test_position_size_and_triangulation_do_not_matter():
    sides = (0.5, 1.0, 2.0)
    vertices, faces = block(sides)
    turned = vertices @ Rotation.from_euler("xyz", (0.4, 1.1, -2.0)).as_matrix() * 17.0 + (5.0, -3.0, 2.0)
    expected = invariants(vertices, faces)
    np.testing.assert_allclose(invariants(turned, faces), expected, rtol=1e-10)
    np.testing.assert_allclose(invariants(vertices * (-1, 1, 1), faces[:, ::-1]), expected, rtol=1e-12)
    np.testing.assert_allclose(invariants(*block(sides, (3, 4, 5))), expected, rtol=1e-12)
    # A point that no face uses is no part of the body.
    np.testing.assert_allclose(invariants(np.vstack([vertices, [[9, 9, 9]]]), faces), expected, rtol=1e-12)
