"""Equal matrices, 70 eigenpairs: this project's solver against the usual call, both sides in one run.

    python benchmarks/eigensolver.py [--divisions 10] [--skip-superlu]

Prints CPU seconds on one thread and the ratios. The usual call is ``scipy.sparse.linalg.eigsh(K, M=M, k=70,
sigma=20000)``, which factorises with SuperLU; its shift is positive, here scaled to the same place in the spectrum.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from vibraverse.cli import set_threads

set_threads(1)

import numpy as np  # noqa: E402
from scipy.sparse.linalg import eigsh  # noqa: E402

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from meshes import box  # noqa: E402
from vibraverse.physics.basis import build_basis  # noqa: E402
from vibraverse.physics.eigensolver import RIGID, residuals, solve  # noqa: E402
from vibraverse.physics.elasticity import assemble, lame  # noqa: E402
from vibraverse.seeds import rng  # noqa: E402

POISSON, MODES = 0.3, 64


def timed(label, function):
    start = time.process_time()
    result = function()
    seconds = time.process_time() - start
    print(f"{label:<44} {seconds:8.2f} s", flush=True)
    return result, seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--divisions", type=int, default=10, help="bricks along each side; 6 n³ tetrahedra")
    parser.add_argument("--skip-superlu", action="store_true", help="leave the slow side out")
    arguments = parser.parse_args()
    n = arguments.divisions
    points, cells = box((1.8, 1.1, 0.7), (n, n, n))
    operators, _ = timed("assembly", lambda: assemble(points, cells))
    print(f"{len(cells)} tetrahedra, P2, {operators.unknowns} unknowns, {MODES + RIGID} pairs, one thread")
    stiffness, mass = operators.stiffness(*lame(1.0, POISSON)), operators.mass

    ours, lanczos = timed(
        "block Lanczos, PARDISO (default)", lambda: solve(operators, POISSON, MODES, rng=rng("b"))
    )
    _, arpack = timed(
        "ARPACK, PARDISO", lambda: solve(operators, POISSON, MODES, rng=rng("b"), method="arpack")
    )
    print(f"{'':<44} {arpack / lanczos:8.2f} times the default's CPU")
    _, whole = timed(
        "whole basis, Poisson's ratio 0.1 to 0.4", lambda: build_basis(points, cells, rng=rng("b"))
    )
    print(f"{'':<44} {whole / lanczos:8.2f} single solves")
    if arguments.skip_superlu:
        return
    # 20000 (rad/s)² lies far below the first elastic eigenvalue of the published objects, as this does here.
    sigma = 1e-4 * ours.values[0]
    (values, vectors), usual = timed(
        "eigsh(K, M=M, k=70, sigma>0), SuperLU",
        lambda: eigsh(stiffness, M=mass, k=MODES + RIGID, sigma=sigma),
    )
    print(f"{'':<44} {usual / lanczos:8.2f} times the default's CPU")
    difference = np.abs(np.sort(values)[RIGID:] / ours.values - 1).max()
    print(f"largest relative difference of the eigenvalues: {difference:.1e}")
    worst = residuals(stiffness, mass, ours.values, ours.vectors).max()
    theirs = residuals(stiffness, mass, values, vectors)[RIGID:].max()
    print(f"largest residual of the default: {worst:.1e}; of eigsh: {theirs:.1e}")


if __name__ == "__main__":
    main()
