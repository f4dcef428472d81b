"""How far the default resolution is from a fine one: frequencies of generated and bundled objects, solid and hollow.

python benchmarks/accuracy.py [--fine 30000] nut bowl-0000 bell-0000:hollow ...

Both meshes come from the same path; the fine one stands in for the truth. Some 6 GB of memory at 30,000 elements.
"""

from __future__ import annotations

import argparse
import multiprocessing

import numpy as np

MODES = 64


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("objects", nargs="+", help="ids; append :hollow for the hollow body")
    parser.add_argument("--fine", type=int, default=30_000)
    parser.add_argument("--target", type=int, default=5000)
    arguments = parser.parse_args()
    print("| body | elements, default and fine | first 20, largest | all 64, mean | all 64, largest |")
    print("|" + 5 * " --- |")
    for name in arguments.objects:
        # A process each, because the sparse solver keeps the memory of the largest mesh.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            print(pool.apply(_row, (name, arguments.target, arguments.fine)), flush=True)


def _row(name: str, target: int, fine: int) -> str:
    object_, _, solidity = name.partition(":")
    surface = _surface(object_, solidity or "solid")
    (coarse_count, coarse), (fine_count, truth) = (_frequencies(surface, count) for count in (target, fine))
    error = np.abs(coarse / truth - 1)
    return (
        f"| {object_}, {solidity or 'solid'} | {coarse_count:,} and {fine_count:,} | {100 * error[:20].max():.2f} % "
        f"| {100 * error.mean():.2f} % | {100 * error.max():.2f} % |"
    )


def _surface(object_: str, solidity: str):
    from vibraverse.geometry.clean import clean
    from vibraverse.geometry.grids import Sampler
    from vibraverse.geometry.hollow import hollow
    from vibraverse.meshfiles import read_mesh
    from vibraverse.seeds import rng
    from vibraverse.sources.bundled import BUNDLED, locate
    from vibraverse.sources.families import generate

    mesh = read_mesh(locate(object_), "ply") if object_ in BUNDLED else generate(object_)
    body = clean(mesh.vertices, mesh.faces)
    surface = body.vertices, body.faces
    if solidity == "solid":
        return surface
    t = float(rng(object_, "hollow").uniform(0.3, 0.7))
    made = hollow(*surface, Sampler(*surface).signed_distance(128), t)
    return made.vertices, made.faces


def _frequencies(surface, target: int) -> tuple[int, np.ndarray]:
    from vibraverse.geometry.tets import tetrahedralise
    from vibraverse.physics.eigensolver import solve
    from vibraverse.physics.elasticity import assemble

    mesh = tetrahedralise(*surface, target)
    pairs = solve(
        assemble(mesh.points, mesh.cells, 2), 0.3, MODES, rng=np.random.default_rng(0), tolerance=1e-4
    )
    return len(mesh.cells), np.sqrt(pairs.values[-MODES:])


if __name__ == "__main__":
    main()
