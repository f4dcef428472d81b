"""Convergence of the first 20 frequencies with the number of unknowns, for linear and quadratic elements.

python benchmarks/convergence.py [--fine 18000] [block ball hollow-ball nut bowl-0000]

Bodies of the validation are compared with their references, others with corrected quadratic elements on a fine mesh.
"""

from __future__ import annotations

import argparse
import multiprocessing
from dataclasses import replace

import numpy as np

MODES, POISSON, SIZES = 20, 0.3, (500, 1500, 4500, 9000)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "bodies", nargs="*", default=["block", "ball", "hollow-ball", "nut", "bowl-0000"], metavar="BODY"
    )
    parser.add_argument("--fine", type=int, default=18_000)
    arguments = parser.parse_args()
    print("| body | tetrahedra | unknowns P1 | P1 | P1 corrected | unknowns P2 | P2 | P2 corrected |")
    print("|" + 8 * " --- |")
    for name in arguments.bodies:
        # A process each, because the sparse solver keeps the memory of the largest mesh.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            print(pool.apply(rows, (name, arguments.fine)), flush=True)


def rows(name: str, fine: int) -> str:
    from vibraverse.report.quantities import number
    from vibraverse.validation.bodies import BODIES

    truth, scale_m, meshes = known(BODIES[name]) if name in BODIES else finest(name, fine)
    lines = []
    for mesh in meshes:
        cells = [name, f"{len(mesh.cells):,}"]
        for order in (1, 2):
            unknowns, *found = frequencies(mesh, order, POISSON, scale_m)
            errors = [100 * np.abs(hz / truth - 1).max() for hz in found]
            cells += [f"{unknowns:,}", *(f"{number(error, 2)} %" for error in errors)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def known(body):
    """Return the frequencies of a body of the validation for E = ρ = 1, metres per mesh unit, and its meshes."""
    from vibraverse.validation.meshes import meshes
    from vibraverse.validation.references import references

    body = replace(body, young_pa=1.0, density_kg_m3=1.0, elements=SIZES, finer=())
    lines = [line for line in references(replace(body, modes=MODES), POISSON) if not line.published]
    truth = np.concatenate([[line.hz] * line.count for line in lines])[:MODES]
    return truth, *meshes(body)


def finest(name: str, fine: int):
    """Return the frequencies of an object on a fine mesh, 1, and its meshes."""
    from accuracy import surface

    from vibraverse.geometry.meshing.tets import tetrahedralise

    object_, _, solidity = name.partition(":")
    outside = surface(object_, solidity or "solid")
    truth = frequencies(tetrahedralise(*outside, fine), 2, POISSON, 1.0)[-1]
    return truth, 1.0, [tetrahedralise(*outside, count) for count in SIZES]


def frequencies(mesh, order: int, poisson: float, scale_m: float) -> tuple[int, np.ndarray, np.ndarray]:
    """Return the number of unknowns, and the frequencies before and after correction, for E = ρ = 1."""
    from vibraverse.physics.basis import build_basis
    from vibraverse.physics.modes import solve_material

    basis = build_basis(
        mesh.points,
        mesh.cells,
        rng=np.random.default_rng(0),
        order=order,
        modes=MODES,
        poisson_range=(poisson, poisson),
    )
    names = ("young_pa", "density_kg_m3", "poisson", "alpha_per_s", "beta_s")
    material = dict(zip(names, (1.0, 1.0, poisson, 0.0, 0.0), strict=True))
    as_is, corrected = (
        solve_material(basis, material, scale_m, MODES, corrected).frequencies_hz
        for corrected in (False, True)
    )
    return basis.n_unknowns, as_is, corrected


if __name__ == "__main__":
    main()
