"""New materials from the basis against sparse solves: time, error and error estimate.

    python benchmarks/materials.py [--materials 20] [--sampled 1000] [OBJECT[:hollow] ...]

Materials are random over the range of real ones (E 5e8 to 5e11 Pa, ρ 500 to 10,000 kg/m³, ν 0.1 to 0.4). Both sides use
the same matrices; the error of the sparse solve is about 1e-9. The time of a material covers frequencies, damping and
mode shapes (as coefficients) on one thread, after the basis is read.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time

from vibraverse.machine.threads import set_threads

set_threads(1)

import numpy as np  # noqa: E402
from accuracy import surface  # noqa: E402

MODES = 64
OBJECTS = (
    "nut", "bowl-0000", "bell-0000", "tuning-fork-0000", "gear-0000",
    "vase-0000", "nut:hollow", "bowl-0000:hollow", "cup-0000", "spoon-0000",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("objects", nargs="*", default=OBJECTS, help="ids; append :hollow for the hollow body")
    parser.add_argument("--materials", type=int, default=20, help="materials per object")
    parser.add_argument("--sampled", type=int, default=1000, help="sampled materials per object")
    arguments = parser.parse_args()
    print(
        "| body | unknowns | basis, CPU s | a material, CPU ms: median, largest | error, largest | estimate / error "
        f"| {arguments.sampled:,} sampled, CPU s; ms a material | MB |"
    )
    print("|" + 8 * " --- |")
    rows = []
    for name in arguments.objects:
        # One process each, because the sparse solver keeps the memory of the largest mesh.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            row = pool.apply(_row, (name, arguments.materials, arguments.sampled))
        rows.append(row)
        milliseconds, error, ratio = row["milliseconds"], row["error"], row["ratio"]
        print(
            f"| {name} | {row['unknowns']:,} | {row['seconds']:.1f} | {np.median(milliseconds):.1f}, "
            f"{max(milliseconds):.1f} | {error:.1e} | {ratio.min():.2f} to {ratio.max():.2g} "
            f"| {row['sampled_s']:.1f}, {1000 * row['sampled_s'] / arguments.sampled:.1f} | {row['sampled_mb']:.2f} |",
            flush=True,
        )
    every = np.concatenate([row["milliseconds"] for row in rows])
    ratios = np.concatenate([row["ratio"] for row in rows])
    print(
        f"{len(every)} materials: median {np.median(every):.1f} ms, 95th percentile {np.percentile(every, 95):.1f} ms; "
        f"largest error {max(row['error'] for row in rows):.1e}; "
        f"the estimate is {ratios.min():.2f} times the error or more."
    )


def _row(name: str, count: int, many: int) -> dict:
    from vibraverse.config.physics import Sampled
    from vibraverse.contract.seeds import rng
    from vibraverse.geometry.meshing.tets import tetrahedralise
    from vibraverse.physics.basis import build_basis
    from vibraverse.physics.eigensolver import solve
    from vibraverse.physics.elasticity import assemble
    from vibraverse.physics.materials import sampled
    from vibraverse.physics.modes import solve_material, solve_materials

    object_, _, solidity = name.partition(":")
    mesh = tetrahedralise(*surface(object_, solidity or "solid"))
    start = time.process_time()
    basis = build_basis(mesh.points, mesh.cells, rng=rng(name, "basis"), modes=MODES)
    seconds = time.process_time() - start
    operators, random = assemble(mesh.points, mesh.cells), rng(name, "materials")
    milliseconds, errors, estimates = [], [], []
    for _ in range(count):
        material = {
            "young_pa": 10 ** random.uniform(np.log10(5e8), np.log10(5e11)),
            "density_kg_m3": random.uniform(500, 10_000),
            "poisson": random.uniform(0.1, 0.4),
            "alpha_per_s": 5.0,
            "beta_s": 1e-7,
        }
        start = time.process_time()
        solve_material(basis, material, 0.1, MODES)
        milliseconds.append(1000 * (time.process_time() - start))
        # What the basis adds is asked of the mesh as it is: corrections are the same on both sides.
        found = solve_material(basis, material, 0.1, MODES, corrected=False)
        exact = solve(operators, material["poisson"], MODES, rng=rng(name, "direct"), tolerance=1e-5).values
        exact_hz = np.sqrt(exact * material["young_pa"] / material["density_kg_m3"]) / 0.1 / (2 * np.pi)
        errors.append(found.frequencies_hz / exact_hz - 1)
        estimates.append(found.relative_error)
    drawn = sampled(object_, 0, many, Sampled().ranges())
    start = time.process_time()
    solved = solve_materials(basis, drawn, 0.1, MODES)
    sampled_s = time.process_time() - start
    error, estimate = np.concatenate(errors), np.concatenate(estimates)
    # Below this, the error of the sparse solve dominates.
    known = error > 1e-8
    return {
        "unknowns": operators.unknowns,
        "seconds": seconds,
        "milliseconds": milliseconds,
        "sampled_s": sampled_s,
        "sampled_mb": sum(array.nbytes for array in (*drawn.values(), *solved.values())) / 2**20,
        "error": float(np.abs(error).max()),
        "ratio": (estimate / np.where(known, error, 1.0))[known],
    }


if __name__ == "__main__":
    main()
