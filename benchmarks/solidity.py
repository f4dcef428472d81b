"""Does meshing alone reveal whether a body is solid or hollow? Simple classifiers on statistics of tetrahedral meshes.

    python benchmarks/meshes.py --generated 150 --json meshes.json && python benchmarks/solidity.py meshes.json
    python benchmarks/solidity.py results        the meshes of a run
    python benchmarks/solidity.py results --other coarse       whether frequencies reveal the mesh

For each group of statistics: logistic regression and 9 nearest neighbours, trained and tested in 10-fold
cross-validation, both bodies of an object in the same fold. Accuracies are means of 20 shuffles; the interval is a 95 %
bootstrap interval over objects. Chance is 50 %, because only objects with both bodies count. Needs NumPy only.

Hollow bodies are thinner. To test whether meshing reveals more than that, pairs of different objects are compared, one
solid and one hollow, with walls equally thick to 10 % (median number of elements across times median edge).

--other names a run of the same objects with another `tets.target_elements`. It tests whether frequencies reveal the
mesh. The same classifiers get the frequencies of one material. All solid bodies come from one run and all hollow ones
from the other, so the mesh reveals what is solid: in training and test alike, or in the test with the runs swapped. If
frequencies revealed the mesh, the first accuracy would be higher. The last test classifies the mesh itself.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

_FOLDS, _SHUFFLES, _NEIGHBOURS, _BOOTSTRAPS = 10, 20, 9, 2000
#: Group -> prefixes of the names of its statistics.
_GROUPS = {
    "counts of vertices and elements": ("vertices", "elements"),
    "count of surface triangles": ("surface_triangles",),
    "angles and shapes of elements": ("min_dihedral_deg", "radius_ratio", "edge_aspect", "slivers"),
    "edge lengths": ("edge_length",),
    "elements across the wall": ("layers",),
    "counts, angles and shapes": (
        "vertices", "elements", "min_dihedral_deg", "radius_ratio", "edge_aspect", "slivers",
    ),
    "all of these": ("",),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", type=Path, help="the JSON of benchmarks/meshes.py, or a results folder")
    parser.add_argument("--other", type=Path, help="results of the same objects on other meshes")
    parser.add_argument("--material", default="steel")
    arguments = parser.parse_args()
    source = arguments.source
    if arguments.other:
        _print_heard(*(_frequencies(results, arguments.material) for results in (source, arguments.other)))
        return
    pairs = [pair for pair in (_of_run(source) if source.is_dir() else _of_json(source)) if len(pair) == 2]
    names = sorted(set.intersection(*(set(body) for pair in pairs for body in pair.values())))
    values = np.array([[[pair[s][name] for name in names] for s in ("solid", "hollow")] for pair in pairs])
    print(f"{len(pairs)} objects, {values.shape[1] * len(pairs)} bodies\n")
    print("| statistics | logistic regression | 9 nearest neighbours |\n| --- | --- | --- |")
    for group, beginnings in _GROUPS.items():
        chosen = [i for i, name in enumerate(names) if name.startswith(beginnings)]
        if chosen:
            cells = [_cell(_right(values[:, :, chosen], method)) for method in (_logistic, _nearest)]
            print(f"| {group} ({len(chosen)}) | {' | '.join(cells)} |", flush=True)
    _print_matched(names, values)
    print(
        "\n| single statistic | median, solid | median, hollow | larger in the hollow body |\n|"
        + 4 * " --- |"
    )
    share = (values[:, 1] > values[:, 0]).mean(axis=0) + 0.5 * (values[:, 1] == values[:, 0]).mean(axis=0)
    for i in np.argsort(-np.abs(share - 0.5)):
        solid, hollow = np.median(values[:, :, i], axis=0)
        print(f"| {names[i]} | {solid:.4g} | {hollow:.4g} | {100 * share[i]:.0f} % |")


def _print_matched(names: list[str], values: np.ndarray) -> None:
    """Print the accuracies for pairs of equal wall thickness; each body is in one pair."""
    across, edge = names.index("layers.median"), names.index("edge_length.median")
    thick = np.log(values[:, :, across] * values[:, :, edge])
    apart = np.abs(thick[:, None, 0] - thick[None, :, 1])
    np.fill_diagonal(apart, np.inf)
    pairs, taken = [], (set(), set())
    for solid, hollow in zip(*np.unravel_index(np.argsort(apart, axis=None), apart.shape), strict=True):
        if apart[solid, hollow] > np.log(1.1):
            break
        if solid not in taken[0] and hollow not in taken[1]:
            pairs.append((solid, hollow))
            taken[0].add(solid)
            taken[1].add(hollow)
    matched = np.array([[values[solid, 0], values[hollow, 1]] for solid, hollow in pairs])
    print(
        f"\n{len(pairs)} pairs of equal thickness:\n\n| statistics | logistic regression | 9 nearest neighbours |"
    )
    print("| --- | --- | --- |")
    for group in (
        "counts of vertices and elements",
        "angles and shapes of elements",
        "counts, angles and shapes",
    ):
        chosen = [i for i, name in enumerate(names) if name.startswith(_GROUPS[group])]
        cells = [_cell(_right(matched[:, :, chosen], method)) for method in (_logistic, _nearest)]
        print(f"| {group} ({len(chosen)}) | {' | '.join(cells)} |", flush=True)


def _print_heard(here: dict, there: dict) -> None:
    """Print the accuracies of solidity from frequencies, with the same meshes and with others."""
    names = sorted(here.keys() & there.keys())
    runs = np.array([[run[name] for name in names] for run in (here, there)])  # (run, object, body, k)
    change = np.abs(np.expm1(runs[1] - runs[0]))
    print(
        f"{len(names)} objects; frequencies of the two runs differ by {100 * np.median(change):.2f} % in the median, "
        f"{100 * np.percentile(change, 95):.2f} % at most for 95 % of them\n"
    )
    relative = np.concatenate([runs[..., :1], runs[..., 1:] - runs[..., :1]], axis=-1)
    first, second = relative
    told = np.stack([first[:, 0], second[:, 1]], axis=1), np.stack([second[:, 0], first[:, 1]], axis=1)
    print(
        "| trained on | tested on | logistic regression | 9 nearest neighbours |\n| --- | --- | --- | --- |"
    )
    for trained, tested, train, test in (
        ("first", "first", first, first),
        ("first", "second", first, second),
        ("second", "second", second, second),
        ("second", "first", second, first),
    ):
        cells = [_cell(_right(train, method, test)) for method in (_logistic, _nearest)]
        print(f"| {trained} | {tested} | {' | '.join(cells)} |", flush=True)
    print(
        "\n| the mesh says what is solid | logistic regression | 9 nearest neighbours |\n| --- | --- | --- |"
    )
    found = {}
    for truth, order in (("in training and test", 1), ("in the test the wrong way round", -1)):
        found[truth] = [
            0.5 * sum(_right(train, method, test) for train, test in zip(told, told[::order], strict=True))
            for method in (_logistic, _nearest)
        ]
        print(f"| {truth} | {' | '.join(map(_cell, found[truth]))} |", flush=True)
    right, wrong = found.values()
    cells = [_cell(a - b) for a, b in zip(right, wrong, strict=True)]
    print(f"| difference: what is heard of the mesh | {' | '.join(cells)} |")
    print("\n| which mesh it was | logistic regression | 9 nearest neighbours |\n| --- | --- | --- |")
    for body, solidity in enumerate(("solid", "hollow")):
        pairs = relative[:, :, body].swapaxes(0, 1)
        print(
            f"| {solidity} | {' | '.join(_cell(_right(pairs, method)) for method in (_logistic, _nearest))} |"
        )


def _frequencies(results: Path, material: str) -> dict[str, np.ndarray]:
    """Return object -> natural logarithms of the frequencies (2, m) of its solid and hollow body, if it has both."""
    import h5py

    from vibraverse.contract.refusal import read_refusal
    from vibraverse.files.modes import read_spectrum

    found = {}
    for folder in sorted((results / "objects").iterdir()):
        paths = [folder / solidity / "modes.h5" for solidity in ("solid", "hollow")]
        if any(not path.is_file() or read_refusal(path) for path in paths):
            continue
        spectra = []
        for path in paths:
            with h5py.File(path) as h5:
                spectra.append(np.log(read_spectrum(h5, material)[0]))
        found[folder.name] = np.array(spectra)
    return found


def _of_json(path: Path):
    for row in json.loads(path.read_text()):
        bodies = row.get("bodies", {})
        yield {solidity: _flat(found) for solidity, found in bodies.items() if "refused" not in found}


def _of_run(results: Path):
    for folder in sorted((results / "objects").iterdir()):
        pair = {}
        for solidity in ("solid", "hollow"):
            try:
                record = json.loads((folder / solidity / "tets.json").read_text())
            except (FileNotFoundError, ValueError):  # not made, or a refusal
                continue
            pair[solidity] = _flat({**record, "elements": record["tetrahedra"]})
        yield pair


def _flat(found: dict) -> dict[str, float]:
    """Return the statistics of a body by name, counts as logarithms."""
    flat = {
        name: float(np.log(found[name]))
        for name in ("vertices", "elements", "surface_triangles")
        if name in found
    }
    for name, value in found["quality"].items():
        if isinstance(value, dict):
            flat |= {f"{name}.{key}": float(number) for key, number in value.items()}
    flat["slivers"] = float(np.log1p(found["quality"]["slivers"]))
    return flat


def _right(values: np.ndarray, method, others: np.ndarray | None = None) -> np.ndarray:
    """Return the share of correct classifications of each object, (objects,), from statistics (objects, 2, k).

    Training uses ``values``; testing uses ``others`` if given, else ``values``.
    """
    others = values if others is None else others
    right = np.zeros(len(values))
    random = np.random.default_rng(0)
    for _ in range(_SHUFFLES):
        folds = random.permutation(len(values)) % _FOLDS
        for fold in range(_FOLDS):
            train, test = values[folds != fold], others[folds == fold]
            x, mean = train.reshape(-1, values.shape[2]), train.mean(axis=(0, 1))
            scale = train.std(axis=(0, 1)) + 1e-12
            y = np.tile([0.0, 1.0], len(train))
            said = method((x - mean) / scale, y, (test.reshape(-1, values.shape[2]) - mean) / scale)
            right[folds == fold] += (said.reshape(-1, 2) == [0, 1]).mean(axis=1)
    return right / _SHUFFLES


def _cell(right: np.ndarray) -> str:
    """Return the mean and its interval in per cent, as text, for a share per object (objects,)."""
    random = np.random.default_rng(0)
    means = random.choice(right, (_BOOTSTRAPS, len(right))).mean(axis=1)
    low, high = np.percentile(means, (2.5, 97.5))
    return f"{100 * right.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def _logistic(x: np.ndarray, y: np.ndarray, test: np.ndarray) -> np.ndarray:
    """Fit by Newton's method with a ridge of 1; return the class of every row of ``test``."""
    x, test = (np.column_stack([rows, np.ones(len(rows))]) for rows in (x, test))
    weights = np.zeros(x.shape[1])
    ridge = np.diag([1.0] * (x.shape[1] - 1) + [1e-9])
    for _ in range(30):
        p = 1.0 / (1.0 + np.exp(-np.clip(x @ weights, -30, 30)))
        step = np.linalg.solve((x.T * (p * (1 - p))) @ x + ridge, x.T @ (y - p) - ridge @ weights)
        weights += step
        if np.abs(step).max() < 1e-8:
            break
    return (test @ weights > 0).astype(int)


def _nearest(x: np.ndarray, y: np.ndarray, test: np.ndarray) -> np.ndarray:
    distance = ((test[:, None] - x[None]) ** 2).sum(axis=2)
    return (y[np.argsort(distance, axis=1)[:, :_NEIGHBOURS]].mean(axis=1) > 0.5).astype(int)


if __name__ == "__main__":
    main()
