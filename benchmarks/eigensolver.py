"""70 eigenpairs of the same matrices: this project's solvers against the usual call, in the same run.

    python benchmarks/eigensolver.py [--unknowns 8000 55000] [--bodies box bowl-0000 bell-0000:hollow] [--orders 2 1]

The usual call is ``scipy.sparse.linalg.eigsh(K, M=M, k=70, sigma=20000)``, which factorises with SuperLU. Its shift is
positive; here it is at the same place in the spectrum, far below the first elastic eigenvalue of the published objects.
Every solver runs in a process of its own on one thread. Printed are: CPU seconds from matrices to eigenpairs (for this
project's solvers with the proof that none is missing), the largest relative residual, and the peak memory including
matrices and libraries. --basis adds the whole basis for Poisson's ratios 0.1 to 0.4: from matrices like the others, and
from a mesh with the correction of the element error.
At 150,000 unknowns SuperLU takes five gigabytes on a thin body, and more on a box.
"""

from __future__ import annotations

import argparse
import multiprocessing
import pickle
import resource
import sys
import tempfile
import time
from pathlib import Path

from vibraverse.machine.threads import set_threads

# Before numpy is imported, here and in every process that runs a solver.
set_threads(1)

from accuracy import surface  # noqa: E402

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

POISSON, MODES, TOLERANCE = 0.3, 64, 1e-6
#: First guess of unknowns per tetrahedron, by order.
PER_CELL = {2: 5.0, 1: 0.7}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--unknowns", type=int, nargs="+", default=[8000, 55_000])
    parser.add_argument("--bodies", nargs="+", default=["box", "bowl-0000", "bell-0000:hollow"])
    parser.add_argument("--orders", type=int, nargs="+", default=[2])
    parser.add_argument("--solvers", nargs="+", default=["lanczos", "arpack", "lobpcg", "eigsh"])
    parser.add_argument("--basis", action="store_true")
    arguments = parser.parse_args()
    print("| body, order | unknowns | solver | CPU s | times the first | solves | residual | memory, MB |")
    print("|" + 8 * " --- |", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for body in arguments.bodies:
            for order in arguments.orders:
                for unknowns in arguments.unknowns:
                    _compare(
                        Path(folder),
                        body,
                        order,
                        unknowns,
                        arguments.solvers + ["basis", "basis, corrected"] * arguments.basis,
                    )


def _compare(folder: Path, body: str, order: int, unknowns: int, solvers: list[str]) -> None:
    count = _alone(_prepare, folder, body, order, unknowns)
    first = None
    for solver in solvers:
        seconds, solves, residual, values, memory = _alone(_run, folder, solver, first and first[1][0])
        first = first or (seconds, values)
        print(
            f"| {body}, {order} | {count:,} | {solver} | {seconds:.2f} | {seconds / first[0]:.2f} | {solves or ''} "
            f"| {residual:.1e} | {memory:.0f} |",
            flush=True,
        )
        if values and (worst := max(abs(a / b - 1) for a, b in zip(values, first[1], strict=True))) > 1e-9:
            print(f"The eigenvalues of {solver} differ by {worst:.1e}.")


def _alone(function, *arguments):
    """Run in a fresh process, so that peak memory is its own and the sparse solvers keep none."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(function, arguments)


def _prepare(folder: Path, body: str, order: int, unknowns: int) -> int:
    """Write mesh and operators of about the requested size."""
    from vibraverse.physics.elasticity import assemble

    points, cells = _box(order, unknowns) if body == "box" else _meshed(body, order, unknowns)
    operators = assemble(points, cells, order)
    (folder / "operators.pickle").write_bytes(pickle.dumps((points, cells, operators)))
    return operators.unknowns


def _box(order: int, unknowns: int):
    from meshes import box

    # A box of 9 × 8 × 7 bricks and alike.
    n = round((unknowns / 3) ** (1 / 3) / order)
    return box((1.8, 1.1, 0.7), (n + 1, n, n - 1))


def _meshed(body: str, order: int, unknowns: int):
    """Mesh an object repeatedly until the number of unknowns is close."""
    import numpy as np

    from vibraverse.geometry.meshing.tets import tetrahedralise

    name, _, solidity = body.partition(":")
    outside = surface(name, solidity or "solid")
    target = unknowns / PER_CELL[order]
    for _ in range(3):
        mesh = tetrahedralise(*outside, int(target))
        if order == 1:
            nodes = len(mesh.points)
        else:
            edges = np.sort(
                mesh.cells[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1
            )
            nodes = len(mesh.points) + len(np.unique(edges, axis=0))
        if 0.9 < 3 * nodes / unknowns < 1.1:
            break
        target *= unknowns / (3 * nodes)
    return mesh.points, mesh.cells


def _run(folder: Path, solver: str, lowest: float | None):
    """Return CPU seconds, solves, the largest residual, the eigenvalues and the peak memory in MB."""
    import numpy as np
    from scipy.sparse.linalg import eigsh

    from meshes import box
    from vibraverse.contract.limits import keep_memory
    from vibraverse.physics.basis import build_basis
    from vibraverse.physics.columns import residuals
    from vibraverse.physics.eigensolver import RIGID, solve
    from vibraverse.physics.elasticity import assemble
    from vibraverse.physics.materials import lame

    # As in the stage ``basis``; it speeds up the usual call by as much.
    keep_memory()
    random, solves = np.random.default_rng(0), None
    # Libraries are loaded before the clock starts.
    solve(assemble(*box((1, 1, 1), (4, 4, 4))), POISSON, MODES, rng=random, method="lanczos")
    points, cells, operators = pickle.loads((folder / "operators.pickle").read_bytes())
    if solver == "eigsh":
        stiffness, mass = operators.stiffness(*lame(1.0, POISSON)), operators.mass
        del operators
        began = time.process_time()
        values, vectors = eigsh(stiffness, M=mass, k=MODES + RIGID, sigma=1e-4 * lowest)
        seconds = time.process_time() - began
        order = np.argsort(values)[RIGID:]
        values = values[order]
        worst = residuals(stiffness, mass, values, vectors[:, order]).max()
    elif solver.startswith("basis"):
        order = operators.order
        del operators
        spent = _timed_apart()
        began = time.process_time()
        worst = build_basis(points, cells, rng=random, order=order, modes=MODES).residuals.max()
        seconds, values = time.process_time() - began, []
        if solver == "basis":
            seconds -= sum(spent)
    else:
        began = time.process_time()
        pairs = solve(operators, POISSON, MODES, rng=random, method=solver, tolerance=TOLERANCE)
        seconds = time.process_time() - began
        values, solves, worst = pairs.values, pairs.solves, pairs.residuals.max()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return seconds, solves, float(worst), [float(value) for value in values], peak


def _timed_apart() -> list[float]:
    """Return a list to which every later assembly and correction of a basis appends its CPU seconds."""
    from vibraverse.physics import basis

    spent = []

    def timed(function):
        def call(*arguments):
            began = time.process_time()
            try:
                return function(*arguments)
            finally:
                spent.append(time.process_time() - began)

        return call

    basis.assemble, basis.correct = timed(basis.assemble), timed(basis.correct)
    return spent


if __name__ == "__main__":
    main()
