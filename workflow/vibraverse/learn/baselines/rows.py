"""The baselines of a task, fitted on the training side and judged like models."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np

from vibraverse.learn.baselines import correlations, statistics
from vibraverse.learn.judging import Judgement, judged
from vibraverse.learn.sides import TRAIN

#: Epochs of samples that regressions see of a tested side, and of the training side, whose materials change with them.
_EPOCHS = (1, 4)


def baselines(task, descents: Sequence[dict] = ()) -> Iterator[tuple[str, float, Judgement]]:
    """Yield name, seconds and judgement of each baseline of a task.

    ``descents`` are parts of what DiffSound found, see :mod:`vibraverse.learn.descents`. The voxels are then judged
    once more, on the same bodies.
    """
    for name, answers in _BASELINES.get(task.options.task, lambda task: ())(task):
        began = time.perf_counter()
        found = judged(task, answers)
        yield name, time.perf_counter() - began, found
    if descents:
        from vibraverse.learn.descents import joined

        few = copy(task)
        few.sides, answered = joined(task, descents)
        seconds = answered.pop("search_seconds")
        for number, target in enumerate(("own target", "true target")):
            answers = {name: values[:, number] for name, values in answered.items()}
            yield f"DiffSound, {target}", float(seconds[:, number].sum()), judged(few, lambda _, a=answers: a)
        for name, answers in _reconstruction(few):
            yield f"{name}, the bodies of DiffSound", 0.0, judged(few, answers)


def _frequencies(task):
    """Yield the baselines of task ``frequencies``: those that learn from the training bodies, then Ritz's method.

    Each body counts in all named materials.
    """
    samples, many = task.samples, len(task.samples.materials)

    def hertz(tested: statistics.Bodies, log_omega: np.ndarray) -> dict[str, np.ndarray]:
        return {"found_hz": tested.hertz(log_omega).reshape(-1, many, log_omega.shape[-1])}

    trained, log_omega = known(samples, task.sides[TRAIN])
    for name, fit in statistics.BASELINES.items():

        def answers(side: str, fit=fit) -> dict[str, np.ndarray]:
            tested = in_all_materials(samples, task.sides[side])
            return hertz(tested, fit(trained, log_omega)(tested))

        yield name, answers

    polynomials = [f"polynomial Ritz, N = {degree}" for degree in samples.ritz_degrees]
    splines = [f"spline Ritz, {unknowns:,} unknowns" for unknowns in samples.ritz_unknowns]
    for number, name in enumerate(polynomials + splines):

        def answers(side: str, number=number) -> dict[str, np.ndarray]:
            tested = in_all_materials(samples, task.sides[side])
            return hertz(tested, tested.ritz[:, number])

        yield name, answers


def known(samples, chosen: np.ndarray) -> tuple[statistics.Bodies, np.ndarray]:
    """Return bodies in all named materials, and the logarithms of their dimensionless frequencies (n, m)."""
    found = in_all_materials(samples, chosen)
    frequencies = samples.rows("frequencies_hz", chosen)
    return found, found.log_omega(frequencies.reshape(-1, frequencies.shape[-1]))


def in_all_materials(samples, chosen: np.ndarray) -> statistics.Bodies:
    """Return what predictors may know of bodies, each in all named materials, one below the other."""
    materials, many = list(samples.materials), len(samples.materials)
    parameters = {
        name: np.tile([samples.materials[one][name] for one in materials], len(chosen))
        for name in ("young_pa", "density_kg_m3", "poisson")
    }
    return statistics.Bodies(
        invariants=np.repeat(samples.rows("invariants", chosen), many, axis=0),
        volume_m3=np.repeat(samples.rows("volume_m3", chosen), many),
        ritz=np.concatenate(_at_materials(samples, chosen)),
        material=np.tile(materials, len(chosen)),
        **parameters,
    )


def _at_materials(samples, bodies: np.ndarray) -> np.ndarray:
    """Return the logarithms of the Ritz frequencies (n, materials, d, m) at the materials' Poisson's ratios."""
    at = np.interp(
        [one["poisson"] for one in samples.materials.values()],
        samples.poisson,
        np.arange(len(samples.poisson)),
    )
    low = np.minimum(at.astype(int), len(samples.poisson) - 2)
    share = (at - low)[:, None, None]
    stored = samples.rows("ritz", bodies).astype(np.float64)
    return (1 - share) * stored[:, low] + share * stored[:, low + 1]


def _solidity(task):
    """Yield simple classifiers on the frequencies of task ``solidity``."""
    from sklearn.ensemble import ExtraTreesClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    def seen(side: str) -> tuple[np.ndarray, np.ndarray]:
        data = task.dataset(side)
        items = [data[0, index] for index in range(len(data))]
        return np.array([item["ratios"] for item in items]), np.array([item["label"] for item in items])

    seed = task.options.seed
    models = {
        "logistic regression": make_pipeline(StandardScaler(), LogisticRegression(max_iter=2000)),
        "extra trees": ExtraTreesClassifier(n_estimators=300, random_state=seed, n_jobs=1),
    }
    for name, model in models.items():

        def answers(side: str, model=model) -> dict[str, np.ndarray]:
            model.fit(*seen(TRAIN))
            return {"hollow": model.predict_proba(seen(side)[0])[:, 1]}

        yield name, answers


def _reconstruction(task):
    """Yield the voxels of task ``reconstruction``, as they are and smoothed."""
    from vibraverse.learn.baselines.voxels import VOXELS

    for name, field_of in VOXELS.items():

        def answers(side: str, field_of=field_of) -> dict[str, np.ndarray]:
            bodies = task.sides[side]
            found = [
                task.measured(field_of(task.samples.row("voxels", body)), body, poisson)
                for body, poisson in zip(bodies, task.poisson(bodies), strict=True)
            ]
            return {measure: np.array([one[measure] for one in found]) for measure in found[0]}

        yield name, answers


def _cavity(task):
    """Yield simple regressions of the thickness in task ``cavity``, from what its models get."""
    from sklearn.dummy import DummyRegressor
    from sklearn.ensemble import ExtraTreesRegressor
    from sklearn.linear_model import RidgeCV
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    def seen(side: str) -> tuple[np.ndarray, np.ndarray]:
        data = task.dataset(side)
        items = [data[epoch, index] for epoch in range(_EPOCHS[side == TRAIN]) for index in range(len(data))]
        return np.array([item["known"] for item in items]), np.array([item["t"] for item in items])

    models = {
        "training mean": DummyRegressor(),
        "ridge regression": make_pipeline(StandardScaler(), RidgeCV(np.logspace(-3, 3, 13))),
        "extra trees": ExtraTreesRegressor(n_estimators=300, random_state=task.options.seed, n_jobs=1),
    }
    for name, model in models.items():

        def answers(side: str, model=model) -> dict[str, np.ndarray]:
            model.fit(*seen(TRAIN))
            return {"t": model.predict(seen(side)[0])}

        yield name, answers


def _retrieval(task):
    """Yield chance, the material alone, linear correlations, and the nearest spectrum by Ritz's method."""
    samples, many = task.samples, len(task.samples.materials)

    def ritz(bodies: np.ndarray) -> dict[str, np.ndarray]:
        tested, true_hz = in_all_materials(samples, bodies), samples.rows("frequencies_hz", bodies)
        return correlations.spectrum_match(true_hz, tested.hertz(tested.ritz[:, -1]).reshape(true_hz.shape))

    models = {
        "chance": lambda: lambda bodies: correlations.chance(len(bodies)),
        "material oracle": lambda: lambda bodies: correlations.material_oracle(len(bodies), many),
        "linear CCA": lambda: correlations.canonical_correlations(samples, task.sides[TRAIN]),
        "finest Ritz, nearest spectrum": lambda: ritz,
    }
    for name, fit in models.items():

        def answers(side: str, fit=fit) -> dict[str, np.ndarray]:
            return {**fit()(task.sides[side]), "material": task.materials(side)}

        yield name, answers


#: Task -> function that yields name and answers of each baseline; a task may have none.
_BASELINES = {
    "frequencies": _frequencies,
    "solidity": _solidity,
    "reconstruction": _reconstruction,
    "cavity": _cavity,
    "retrieval": _retrieval,
}
