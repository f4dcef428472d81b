"""Error of a model of task `frequencies` against the number of objects, and of families, that it is trained on.

    python benchmarks/growth.py RESULTS [--model ritz] [--hold-out files] [--seeds 1] [--shares 0.125 0.25 0.5 1]

RESULTS is a run's folder with features and splits. Two questions, each with the tested bodies kept the same: the split
by object with a share of the objects of each family, and the splits by family with a share of the families. A
training stops at the preset's steps, whatever the number of bodies.
"""

from __future__ import annotations

import argparse
import tempfile
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
    parser.add_argument("--shares", type=float, nargs="+", default=[0.125, 0.25, 0.5, 1.0])
    parser.add_argument("--folds", type=int, nargs="+", default=list(range(5)), help="splits by family")
    parser.add_argument("--steps", type=int, help="in place of the preset's")
    arguments = parser.parse_args()
    print("| split | families | objects | bodies | median | mode 1 | 90th percentile |")
    print("|" + 7 * " --- |")
    for split, of in (("object", "object"), ("family", "family")):
        for share in arguments.shares:
            names = [split] if split == "object" else [f"family-{fold}" for fold in arguments.folds]
            found = [
                trained(arguments, name, of, share, seed) for name in names for seed in range(arguments.seeds)
            ]
            counts = np.mean([one[0] for one in found], axis=0)
            errors = np.concatenate([one[1] for one in found])
            told = (np.median(errors), np.median(errors[:, 0]), np.percentile(errors, 90))
            cells = [f"{count:.0f}" for count in counts] + [f"{100 * one:.2f} %" for one in told]
            print(f"| {split} | {' | '.join(cells)} |", flush=True)


def trained(arguments, split: str, of: str, share: float, seed: int) -> tuple[list[int], np.ndarray]:
    """Return how many families, objects and bodies were trained on, and the relative errors (n, modes) in the test."""
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
    task.sides[TRAIN] = kept(task.samples, task.sides[TRAIN], of, share, seed)
    with tempfile.TemporaryDirectory() as work:
        done = train(task, options.training, Path(work), seed=seed, facts={}, say=lambda line: None)
    _, answers = evaluate(task, done.model, "test", options.training)
    used = task.sides[TRAIN]
    names = [task.samples.family[used], task.samples.object[used], used]
    errors = np.abs(np.expm1(answers["found"].astype(float) - answers["true"]))
    return [len(set(one.tolist())) for one in names], errors


def kept(samples, bodies: np.ndarray, of: str, share: float, seed: int) -> np.ndarray:
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
