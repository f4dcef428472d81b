"""The baselines of a task, fitted on the training side and judged like models."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from vibraverse.learn.baselines import statistics
from vibraverse.learn.judging import judged
from vibraverse.learn.sides import TRAIN


def baselines(task) -> Iterator[tuple[str, float, list[dict]]]:
    """Yield name, seconds and rows of each baseline of a task."""
    for name, answers in {"frequencies": _frequencies, "solidity": _solidity}[task.options.task](task):
        began = time.perf_counter()
        _, rows = judged(task, answers)
        yield name, time.perf_counter() - began, rows


def _frequencies(task):
    """Yield the statistical baselines of task ``frequencies``; each training body in all named materials."""
    samples = task.samples
    materials = list(samples.materials)

    def bodies_of(side: str) -> statistics.Bodies:
        chosen, many = task.sides[side], len(materials)
        parameters = {
            name: np.tile([samples.materials[one][name] for one in materials], len(chosen))
            for name in ("young_pa", "density_kg_m3", "poisson")
        }
        return statistics.Bodies(
            invariants=np.repeat(samples.rows("invariants", chosen), many, axis=0),
            volume_m3=np.repeat(samples.rows("volume_m3", chosen), many),
            material=np.tile(materials, len(chosen)),
            **parameters,
        )

    trained = bodies_of(TRAIN)
    frequencies = samples.rows("frequencies_hz", task.sides[TRAIN])
    log_omega = trained.log_omega(frequencies.reshape(-1, frequencies.shape[-1]))
    for name, fit in statistics.BASELINES.items():

        def answers(side: str, fit=fit) -> dict[str, np.ndarray]:
            tested = bodies_of(side)
            found = tested.hertz(fit(trained, log_omega)(tested))
            return {"found_hz": found.reshape(-1, len(materials), found.shape[-1])}

        yield name, answers


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
