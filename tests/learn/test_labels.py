"""Exact labels in batches equal those of the stage ``modes``."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from skfem import MeshTet  # noqa: E402

from vibraverse.contract.seeds import rng  # noqa: E402
from vibraverse.learn.labels import operators, spectra  # noqa: E402
from vibraverse.physics.basis import build_basis  # noqa: E402
from vibraverse.physics.modes import solve_material  # noqa: E402

pytestmark = pytest.mark.learn
MODES = 10


@pytest.fixture(scope="module")
def bases():
    """Bases of three boxes, of different ranks."""
    sizes, errors = [(1.8, 0.5, 0.4), (1.8, 1.2, 0.3), (1.0, 1.0, 1.0)], (1e-5, 1e-4, 1e-3)
    return [
        build_basis(*box(sides), rng=rng(str(sides)), order=1, modes=MODES, max_error=error)
        for sides, error in zip(sizes, errors, strict=True)
    ]


def box(sides) -> tuple[np.ndarray, np.ndarray]:
    """Return points and positively oriented tetrahedra of a box."""
    axes = [np.linspace(-side / 2, side / 2, count) for side, count in zip(sides, (9, 5, 4), strict=True)]
    mesh = MeshTet.init_tensor(*axes)
    points, cells = mesh.p.T.copy(), mesh.t.T.copy()
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    wrong = np.linalg.det(edges) < 0
    cells[wrong] = cells[wrong][:, [0, 2, 1, 3]]
    return points, cells


@pytest.mark.parametrize("corrected", [True, False])
def test_spectra_are_those_of_the_stage(bases, corrected):
    assert len({len(basis.a_mu) for basis in bases}) > 1  # otherwise nothing is padded
    batch = operators(bases)
    for poisson in (0.12, 0.25, 0.39):
        found = spectra(batch, torch.full((3,), poisson, dtype=torch.float64), MODES, corrected).numpy()
        for basis, one in zip(bases, found, strict=True):
            material = {
                "young_pa": 1.0,
                "density_kg_m3": 1.0,
                "poisson": poisson,
                "alpha_per_s": 0,
                "beta_s": 0,
            }
            expected = solve_material(basis, material, 1.0, MODES, corrected).frequencies_hz * 2 * np.pi
            np.testing.assert_allclose(one, expected * np.cbrt(basis.volume), rtol=1e-9)


def test_each_body_may_have_its_own_material(bases):
    batch, ratios = operators(bases), torch.tensor([0.15, 0.3, 0.35], dtype=torch.float64)
    together = spectra(batch, ratios, MODES)
    for number in range(3):
        alone = spectra(batch[torch.tensor([number])], ratios[number : number + 1], MODES)
        torch.testing.assert_close(together[number], alone[0], rtol=1e-12, atol=0)


def test_bases_of_different_numbers_of_modes_are_no_batch(bases):
    import dataclasses

    with pytest.raises(ValueError, match="the bases have"):
        operators([bases[0], dataclasses.replace(bases[1], residuals=np.zeros(3))])
