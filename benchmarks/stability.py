"""Sensitivity of frequencies to the description of an object: rotation, scale, position, triangulation, numbering.

    python benchmarks/stability.py [--seeds 2] [OBJECT[:hollow] ...]

Every description goes through all stages from cleaning to the eigensolver. Printed is the largest change of the first
20 corrected frequencies against the original object.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
from pathlib import Path

from vibraverse.machine.threads import set_threads

set_threads(1)
sys.path.append(str(Path(__file__).parent.parent / "tests"))

import numpy as np  # noqa: E402

OBJECTS = (
    "nut", "bell-0000", "bowl-0000", "cup-0000", "gear-0000", "tuning-fork-0000", "vase-0000",
    "nut:hollow", "bell-0000:hollow", "bowl-0000:hollow", "tuning-fork-0000:hollow", "vase-0000:hollow",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("objects", nargs="*", default=OBJECTS, help="ids; append :hollow for the hollow body")
    parser.add_argument("--seeds", type=int, default=2, help="descriptions of each")
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args()
    seeds = range(arguments.seeds + 1)
    jobs = [(name, seed) for name in arguments.objects for seed in seeds]
    print("| body | elements | change of the first 20 frequencies: largest, mean |")
    print("|" + 3 * " --- |")
    # One process each, because the sparse solver keeps the memory of the largest mesh.
    with multiprocessing.get_context("spawn").Pool(arguments.workers, maxtasksperchild=1) as pool:
        results = pool.imap(_described, jobs, chunksize=1)
        for name in arguments.objects:
            found = [next(results) for _ in seeds]
            changes = [frequencies / found[0][1] - 1 for _, frequencies in found[1:]]
            counts = ", ".join(f"{count:,}" for count, _ in found)
            told = "; ".join(f"{100 * np.abs(c).max():.2f}, {100 * c.mean():+.2f} %" for c in changes)
            print(f"| {name} | {counts} | {told} |", flush=True)


def _described(job: tuple[str, int]) -> tuple[int, np.ndarray]:
    """Return the number of elements and the frequencies of an object, original (0) or in another description."""
    from test_stability import described_anew, frequencies, source
    from vibraverse.contract.seeds import rng

    (name, _, solidity), seed = job[0].partition(":"), job[1]
    vertices, faces, scale = *source(name), 1.0
    if seed:
        vertices, faces, scale = described_anew(vertices, faces, seed)
    t = float(rng(name, "hollow").uniform(0.3, 0.7))
    return frequencies(vertices, faces, solidity or "solid", scale, t)


if __name__ == "__main__":
    main()
