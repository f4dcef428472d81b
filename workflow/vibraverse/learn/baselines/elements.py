"""Baselines with finite elements: ARPACK, the modal basis of the workflow, and few elements.

All solve for one material. ``material`` holds ``young_pa``, ``density_kg_m3`` and ``poisson``; ``scale_m`` is metres
per mesh unit. They raise :class:`vibraverse.contract.errors.Refused` if a body cannot be meshed or solved.
"""

from __future__ import annotations

import numpy as np

from vibraverse.learn.baselines.galerkin import Clock, Spectrum, hertz
from vibraverse.physics.basis import build_basis
from vibraverse.physics.eigensolver import solve
from vibraverse.physics.elasticity import assemble
from vibraverse.physics.modes import reduced_solve


def arpack(
    points: np.ndarray,
    cells: np.ndarray,
    material: dict,
    scale_m: float,
    *,
    rng: np.random.Generator,
    order: int = 2,
    modes: int = 64,
    tolerance: float = 1e-5,
) -> Spectrum:
    """Return the frequencies of tetrahedra (N, 3), (T, 4) by ARPACK with a factorised shift, proven complete."""
    clock = Clock()
    with clock.part("assembly"):
        operators = assemble(points, cells, order)
    with clock.part("eigensolver"):
        pairs = solve(operators, material["poisson"], modes, rng=rng, method="arpack", tolerance=tolerance)
    return Spectrum(hertz(pairs.values, material, scale_m), clock.seconds)


def modal_basis(
    points: np.ndarray,
    cells: np.ndarray,
    material: dict,
    scale_m: float,
    *,
    rng: np.random.Generator,
    order: int = 2,
    modes: int = 64,
    corrected: bool = True,
    poisson_range: tuple[float, float] | None = None,
) -> Spectrum:
    """Return the frequencies of tetrahedra (N, 3), (T, 4) through the workflow's modal basis.

    Without ``poisson_range`` the basis is made for the material's Poisson's ratio alone, which takes less time.
    """
    clock = Clock()
    poisson = material["poisson"]
    with clock.part("basis"):
        basis = build_basis(
            points,
            cells,
            rng=rng,
            order=order,
            modes=modes,
            poisson_range=poisson_range or (poisson, poisson),
        )
    with clock.part("modes"):
        values = reduced_solve(basis, poisson, modes, corrected).values
    return Spectrum(hertz(values, material, scale_m), clock.seconds)


def coarse(
    vertices: np.ndarray,
    faces: np.ndarray,
    material: dict,
    scale_m: float,
    *,
    rng: np.random.Generator,
    elements: int = 600,
    order: int = 2,
    modes: int = 64,
    corrected: bool = True,
) -> Spectrum:
    """Return the frequencies of the solid in a closed surface (V, 3), (F, 3), meshed with few ``elements``.

    The mesher may take twice as many for thin walls. ``order=1, corrected=False`` gives linear elements; corrected
    quadratic ones are the better use of the same time.
    """
    from vibraverse.geometry.meshing.tets import tetrahedralise

    clock = Clock()
    with clock.part("meshing"):
        mesh = tetrahedralise(vertices, faces, target_elements=elements, max_volume_change=0.02)
    found = modal_basis(
        mesh.points, mesh.cells, material, scale_m, rng=rng, order=order, modes=modes, corrected=corrected
    )
    return Spectrum(found.frequencies_hz, {**clock.seconds, **found.seconds})
