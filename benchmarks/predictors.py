"""Ways to a body's frequencies, on one machine: error against the dataset, and CPU seconds with all that each needs.

python benchmarks/predictors.py RESULTS [--bodies 12] [--material steel] [--seed 0] [--slow]

RESULTS holds a dataset, and what `snakemake learn` made of it. Bodies are drawn from the tested side of the split by
object, and trainings of that split with the seed answer for them. All start from the closed surface, but those that are
said to be on the tetrahedra of the dataset. Fitting and training is not counted. The truth are the dataset's
frequencies, whose elements' own error is mostly taken out; so methods on the same elements, uncorrected, lie above it.
--slow adds LOBPCG from each start with both preconditioners, and ARPACK.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import torch

import vibraverse.dataset
from vibraverse.contract.errors import Refused
from vibraverse.contract.seeds import rng
from vibraverse.dataset.schema import SPLIT_COLUMNS
from vibraverse.dataset.schema.tables import from_tsv
from vibraverse.learn import samples as features
from vibraverse.learn.baselines import elements, lobpcg, starts
from vibraverse.learn.baselines.galerkin import Spectrum
from vibraverse.learn.baselines.polynomials import polynomial_ritz
from vibraverse.learn.baselines.rows import known
from vibraverse.learn.baselines.splines import spline_ritz
from vibraverse.learn.baselines.statistics import BASELINES, Bodies
from vibraverse.learn.features import ritz_spectra
from vibraverse.learn.invariants import invariants
from vibraverse.learn.prediction import Predictor
from vibraverse.learn.sides import TEST, TRAIN, sides
from vibraverse.learn.trained import read
from vibraverse.machine.threads import set_threads
from vibraverse.physics.elasticity import assemble

DEGREES, UNKNOWNS, COARSE = (4, 6, 8), (1000, 3000), (400, 700, 1000)
#: LOBPCG's block: the modes wanted and guards.
_GUARD = 12


class Body:
    """A body of the dataset in one material."""

    def __init__(self, reader, id_: str, material: str):
        self.object, self.solidity = id_.split()
        place = {"object": self.object, "solidity": self.solidity}
        prefix = "surface" if self.solidity == "solid" else "boundary"
        self.surface = tuple(reader.read(f"{prefix}_{part}", **place) for part in ("vertices", "faces"))
        self.tets = tuple(reader.read(f"tet_{part}", **place) for part in ("points", "cells"))
        self.name = material
        self.material = {
            name: float(reader.read(name, **place, material=material))
            for name in ("young_pa", "density_kg_m3", "poisson")
        }
        self.true_hz = reader.read("frequencies_hz", **place, material=material)
        self.volume_m3 = float(reader.read("volume_m3", **place, material=material))
        edges = self.tets[0][self.tets[1][:, 1:]] - self.tets[0][self.tets[1][:, :1]]
        self.scale_m = float(np.cbrt(self.volume_m3 / (np.linalg.det(edges).sum() / 6.0)))


Method = Callable[[Body], np.ndarray]


def timed(make: Callable[[Body], np.ndarray], body: Body) -> tuple[np.ndarray, float]:
    """Return the frequencies of a body, and the CPU seconds that they took."""
    began = time.process_time()
    found = make(body)
    return found, time.process_time() - began


def mechanical(modes: int, slow: bool) -> Iterator[tuple[str, Method]]:
    """Yield Ritz's method, few elements, and the solvers on the dataset's tetrahedra."""
    for degree in DEGREES:
        yield (
            f"polynomial Ritz, N = {degree}",
            lambda body, degree=degree: (
                polynomial_ritz(*body.surface, body.material, body.scale_m, degree, modes).frequencies_hz
            ),
        )
    for unknowns in UNKNOWNS:
        yield (
            f"spline Ritz, {unknowns:,} unknowns",
            lambda body, unknowns=unknowns: (
                spline_ritz(*body.surface, body.material, body.scale_m, unknowns, modes).frequencies_hz
            ),
        )
    for count in COARSE:
        for name, options in (("linear", {"order": 1, "corrected": False}), ("quadratic, corrected", {})):
            if options and count != COARSE[-1]:
                continue
            yield (
                f"{count} elements, {name}",
                lambda body, count=count, options=options: elements.coarse(
                    *body.surface, body.material, body.scale_m, rng=rng("coarse"), elements=count, modes=modes,
                    **options,
                ).frequencies_hz,
            )  # fmt: skip
    solvers = {"modal basis": elements.modal_basis} | ({"ARPACK": elements.arpack} if slow else {})
    for name, solver in solvers.items():
        yield (
            f"{name}, dataset's tetrahedra",
            lambda body, solver=solver: (
                solver(*body.tets, body.material, body.scale_m, rng=rng("solver"), modes=modes).frequencies_hz
            ),
        )
    if slow:
        for start in ("random", "polynomial", "linear"):
            for preconditioner in ("factorised", "jacobi"):
                yield (
                    f"LOBPCG from {start} fields, {preconditioner}, dataset's tetrahedra",
                    partial(iterated, start=start, preconditioner=preconditioner, modes=modes),
                )


def iterated(body: Body, start: str, preconditioner: str, modes: int) -> np.ndarray:
    """Return frequencies by LOBPCG from a start."""
    operators, block, poisson = assemble(*body.tets), modes + _GUARD, body.material["poisson"]
    first = {
        "random": lambda: starts.random(operators, block, rng("start")),
        "polynomial": lambda: starts.polynomial(operators, block, poisson),
        "linear": lambda: starts.linear(operators, block, poisson, rng("start")),
    }[start]()
    found: Spectrum = lobpcg.frequencies(
        operators, first, body.material, body.scale_m, modes=modes, preconditioner=preconditioner
    )[0]
    return found.frequencies_hz


def statistical(samples, trained: np.ndarray) -> Iterator[tuple[str, Method]]:
    """Yield the baselines that learn, fitted on the bodies of the training side in all materials."""
    bodies, spectra = known(samples, trained)
    for name, fit in BASELINES.items():
        predict = fit(bodies, spectra)
        yield name, partial(guessed, predict=predict, samples=samples, uses_ritz="Ritz" in name)


def guessed(body: Body, predict, samples, uses_ritz: bool) -> np.ndarray:
    """Return what a fitted baseline says."""
    modes = len(body.true_hz)
    spaces = samples.ritz_degrees, samples.ritz_unknowns
    ritz = np.zeros((1, sum(map(len, spaces)), modes))
    if uses_ritz:
        ritz = ritz_spectra(*body.surface, [body.material["poisson"]], modes, *spaces)
    one = Bodies(
        invariants=invariants(*body.surface)[None],
        ritz=ritz,
        volume_m3=np.array([body.volume_m3]),
        material=np.array([body.name]),
        **{name: np.array([value]) for name, value in body.material.items()},
    )
    return one.hertz(predict(one))[0]


def networks(results: Path, seed: int) -> Iterator[tuple[str, Method]]:
    """Yield the trained models of the split by object."""
    for folder in sorted((results / "learn/frequencies/object").glob(f"*/seed-{seed}")):
        predictor = Predictor(read(folder))
        yield (
            f"network `{folder.parent.name}`",
            lambda body, predictor=predictor: predictor.frequencies(
                *body.surface, body.object, body.solidity, body.volume_m3, {"it": body.material}
            )[0],
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", type=Path)
    parser.add_argument("--bodies", type=int, default=12, help="tested bodies (default 12)")
    parser.add_argument("--material", default="steel")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--slow", action="store_true", help="LOBPCG and ARPACK, too")
    chosen = parser.parse_args()
    set_threads(1)
    torch.set_num_threads(1)
    samples = features.at(chosen.results)
    table = (chosen.results / "dataset/splits.tsv").read_text(encoding="utf-8")
    rows = {row["object"]: row for row in from_tsv(table, SPLIT_COLUMNS)}
    divided = sides(samples, "object", rows, 5)
    drawn = rng("predictors").permutation(divided[TEST])[: chosen.bodies]
    with vibraverse.dataset.open(chosen.results / "dataset") as reader:
        tested = [Body(reader, samples.ids[body], chosen.material) for body in sorted(drawn)]
    modes = len(tested[0].true_hz)
    methods = [
        *statistical(samples, divided[TRAIN]),
        *networks(chosen.results, chosen.seed),
        *mechanical(modes, chosen.slow),
    ]
    print(f"{len(tested)} bodies, {chosen.material}, one thread")
    print("| way | median error | mode 1 | 90th percentile | CPU s, median | most | refused |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, method in methods:
        found = defaultdict(list)
        timed(method, tested[0])  # the first call imports and compiles
        for body in tested:
            try:
                hertz, seconds = timed(method, body)
            except Refused:
                continue
            found["error"].append(np.abs(hertz / body.true_hz - 1.0))
            found["seconds"].append(seconds)
        error, seconds = np.array(found["error"]), np.array(found["seconds"])
        shares = np.median(error), np.median(error[:, 0]), np.percentile(error, 90)
        print(
            f"| {name} | {' | '.join(f'{share:.2%}' for share in shares)} | {np.median(seconds):.2f} | "
            f"{seconds.max():.2f} | {len(tested) - len(seconds)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
