"""Error of a model of task `frequencies` against the number of objects, and of families, that it is trained on.

    python benchmarks/growth.py RESULTS [--model ritz] [--hold-out files] [--seeds 1] [--shares 0.125 0.25 0.5 1]

RESULTS is a run's folder with features and splits. The tested bodies are the same in all rows of a split: by object
with a share of the objects of each family, by family with a share of the families; with ``--without``, by family with
and without some families in training. A training takes the preset's steps, whatever the number of bodies.
"""

from __future__ import annotations

import argparse
import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from vibraverse.machine.threads import set_threads

set_threads(1)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", type=Path)
    parser.add_argument("--model", default="ritz")
    parser.add_argument("--preset", default="cpu", choices=["tiny", "cpu", "small", "paper"])
    parser.add_argument("--hold-out", nargs="*", default=[], help="origins that are never trained on")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--shares", type=float, nargs="*", default=[0.125, 0.25, 0.5, 1.0])
    parser.add_argument("--folds", type=int, nargs="+", default=list(range(5)), help="splits by family")
    parser.add_argument("--steps", type=int, help="in place of the preset's")
    parser.add_argument(
        "--without", nargs="*", default=[], metavar="FAMILY", help="what these families bring"
    )
    arguments = parser.parse_args()
    by_family = [f"family-{fold}" for fold in arguments.folds]
    print("| split | families | objects | bodies | median | mode 1 | 90th percentile |")
    print("|" + 7 * " --- |")
    for split, names in (("object", ["object"]), ("family", by_family)):
        for share in arguments.shares:
            row(arguments, split, names, partial(kept, of=split, share=share))
    if arguments.without:
        row(arguments, "family, with these", by_family, lambda samples, bodies, seed: bodies)
        row(arguments, "family, without", by_family, partial(others, families=arguments.without))


def row(arguments, label: str, splits: list[str], choose) -> None:
    """Print a row: trainings on what ``choose(samples, bodies, seed)`` leaves of the training side of each split."""
    found = [trained(arguments, split, choose, seed) for split in splits for seed in range(arguments.seeds)]
    counts = np.mean([one[0] for one in found], axis=0)
    errors = np.concatenate([one[1] for one in found])
    told = (np.median(errors), np.median(errors[:, 0]), np.percentile(errors, 90))
    cells = [f"{count:.0f}" for count in counts] + [f"{100 * one:.2f} %" for one in told]
    print(f"| {label} | {' | '.join(cells)} |", flush=True)


def trained(arguments, split: str, choose, seed: int) -> tuple[list[int], np.ndarray]:
    """Return how many families, objects and bodies were trained on, and the relative errors (n, modes) in the test.

    Families that are trained on in one row and not in another are not tested.
    """
    from vibraverse.config.learn import Learn
    from vibraverse.learn.evaluation import evaluate
    from vibraverse.learn.sides import TRAIN
    from vibraverse.learn.tasks import task_at
    from vibraverse.learn.train import train

    own = {} if arguments.steps is None else {"frequencies": {"training": {"steps": arguments.steps}}}
    learn = Learn(preset=arguments.preset, hold_out=arguments.hold_out, **own)
    options = learn.run("frequencies", split, arguments.model, seed)
    records = sorted(arguments.results.glob("learn/features/*/features.json"))
    task = task_at(records, arguments.results / "dataset" / "splits.tsv", options)
    used = task.sides[TRAIN] = choose(task.samples, task.sides[TRAIN], seed)
    with tempfile.TemporaryDirectory() as work:
        done = train(task, options.training, Path(work), seed=seed, facts={}, say=lambda line: None)
    _, answers = evaluate(task, done.model, "test", options.training)
    errors = np.abs(np.expm1(answers["found"].astype(float) - answers["true"]))
    tested = ~np.isin(task.samples.family[task.sides["test"]], arguments.without)
    names = [task.samples.family[used], task.samples.object[used], used]
    return [len(set(one.tolist())) for one in names], errors[tested]


def others(samples, bodies: np.ndarray, seed: int, families: list[str]) -> np.ndarray:
    """Return the bodies (k,) that are of none of these families."""
    return bodies[~np.isin(samples.family[bodies], families)]


def kept(samples, bodies: np.ndarray, seed: int, of: str, share: float) -> np.ndarray:
    """Return the bodies (k,) of a share of the objects of each family, or of a share of the families."""
    random = np.random.default_rng(seed)
    families = samples.family[bodies]
    groups = [bodies] if of == "family" else [bodies[families == one] for one in np.unique(families)]
    chosen: list[np.ndarray] = []
    for group in groups:
        names = getattr(samples, of)[group]
        known = np.unique(names)
        some = random.choice(known, size=max(1, round(share * len(known))), replace=False)
        chosen.append(group[np.isin(names, some)])
    return np.sort(np.concatenate(chosen))


if __name__ == "__main__":
    main()
