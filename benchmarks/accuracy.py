"""Error of the default resolution against a fine one: frequencies of generated and bundled objects, solid and hollow.

python benchmarks/accuracy.py [--fine 25000] nut bowl-0000 bell-0000:hollow block ball ...

Bodies of the validation are given by name.

Both meshes are made by the same code; the corrected frequencies of the fine one are the reference. Errors are those of
the default mesh before and after the correction of the element error. Needs about 6 GB of memory at 25,000 elements.
"""

from __future__ import annotations

import argparse
import multiprocessing

from vibraverse.machine.threads import set_threads

set_threads(1)

import numpy as np  # noqa: E402

MODES = 64


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("objects", nargs="+", help="ids; append :hollow for the hollow body")
    parser.add_argument("--fine", type=int, default=25_000)
    parser.add_argument("--target", type=int, default=5000)
    arguments = parser.parse_args()
    print(
        "| body | elements, default and fine | as the elements give it: first 20, largest; all 64, mean; largest "
        "| corrected: first 20, largest; all 64, mean; largest | CPU s |"
    )
    print("|" + 5 * " --- |")
    for name in arguments.objects:
        # One process each, because the sparse solver keeps the memory of the largest mesh.
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            print(pool.apply(_row, (name, arguments.target, arguments.fine)), flush=True)


def _row(name: str, target: int, fine: int) -> str:
    object_, _, solidity = name.partition(":")
    outside = surface(object_, solidity or "solid")
    coarse, fine = (_frequencies(outside, count) for count in (target, fine))
    told = []
    for frequencies in coarse["plain"], coarse["corrected"]:
        error = 100 * np.abs(frequencies / fine["corrected"] - 1)
        told.append(f"{error[:20].max():.2f}, {error.mean():.2f}, {error.max():.2f} %")
    return (
        f"| {object_}, {solidity or 'solid'} | {coarse['elements']:,} and {fine['elements']:,} | {told[0]} | {told[1]} "
        f"| {coarse['seconds']:.1f} |"
    )


def surface(object_: str, solidity: str):
    from vibraverse.contract.seeds import rng
    from vibraverse.files.meshes import read_mesh
    from vibraverse.geometry.cleaning.clean import clean
    from vibraverse.geometry.grids import Sampler
    from vibraverse.geometry.hollow import hollow
    from vibraverse.sources.bundled import BUNDLED, locate
    from vibraverse.sources.families import generate
    from vibraverse.validation.bodies import BODIES
    from vibraverse.validation.meshes import skin

    if object_ in BODIES:
        return skin(BODIES[object_])[1]
    mesh = read_mesh(locate(object_), "ply") if object_ in BUNDLED else generate(object_)
    body = clean(mesh.vertices, mesh.faces)
    surface = body.vertices, body.faces
    if solidity == "solid":
        return surface
    t = float(rng(object_, "hollow").uniform(0.3, 0.7))
    made = hollow(*surface, Sampler(*surface).signed_distance(128), t)
    return made.vertices, made.faces


def _frequencies(outside, target: int) -> dict:
    import time

    from vibraverse.geometry.meshing.tets import tetrahedralise
    from vibraverse.physics.basis import build_basis
    from vibraverse.physics.modes import reduced_solve

    mesh = tetrahedralise(*outside, target)
    start = time.process_time()
    basis = build_basis(mesh.points, mesh.cells, rng=np.random.default_rng(0), modes=MODES)
    seconds = time.process_time() - start
    plain, corrected = (np.sqrt(reduced_solve(basis, 0.3, MODES, choice).values) for choice in (False, True))
    return {"elements": len(mesh.cells), "plain": plain, "corrected": corrected, "seconds": seconds}


if __name__ == "__main__":
    main()
