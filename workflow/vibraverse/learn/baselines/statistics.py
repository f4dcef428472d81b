"""Statistical baselines: modal frequencies from those of other bodies.

A baseline is ``fit(bodies, log_omega) -> predict`` and ``predict(bodies) -> log_omega``, where ``log_omega`` (n, 64)
are logarithms of ``ω̂ = ω V^(1/3) / sqrt(E/ρ)``, ascending in each row. :meth:`Bodies.hertz` rescales them. All but the
first two baselines are exact in E, ρ and size. :data:`BASELINES` names them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from vibraverse.learn.invariants import thinness
from vibraverse.learn.scaling import from_mel, mel, unit_hz

#: Nearest bodies whose spectra are averaged.
NEIGHBOURS = 3
#: Smallest distance to a neighbour, as a share of the standard deviation: a copy decides, but divides by no zero.
_MIN_DISTANCE = 1e-6
#: Trees of the forest; rounds of boosting, and the directions of the spectra that it predicts.
TREES, ROUNDS, _DIRECTIONS = 300, 300, 8


@dataclass(frozen=True)
class Bodies:
    """Bodies in materials, one per row: all that a predictor may look at.

    ``invariants`` (n, 5) are those of :mod:`vibraverse.learn.invariants`, ``ritz`` (n, d, m) logarithms of the
    dimensionless frequencies by Ritz's method in d spaces, the finest last. ``material`` (n,) holds names, the others
    (n,) are numbers in SI units.
    """

    invariants: np.ndarray
    ritz: np.ndarray
    volume_m3: np.ndarray
    young_pa: np.ndarray
    density_kg_m3: np.ndarray
    poisson: np.ndarray
    material: np.ndarray

    def __len__(self) -> int:
        return len(self.invariants)

    def __getitem__(self, rows) -> Bodies:
        """Return the bodies of some rows."""
        return Bodies(*(getattr(self, field.name)[rows] for field in fields(self)))

    def hertz(self, log_omega: np.ndarray) -> np.ndarray:
        """Return the frequencies in Hz (n, m) of ``log ω̂``."""
        return np.exp(log_omega) * self._unit_hz()

    def log_omega(self, frequencies_hz: np.ndarray) -> np.ndarray:
        """Return ``log ω̂`` of frequencies in Hz (n, m); the inverse of :meth:`hertz`."""
        return np.log(frequencies_hz / self._unit_hz())

    def _unit_hz(self) -> np.ndarray:
        return unit_hz(self.volume_m3, self.young_pa, self.density_kg_m3)[:, None]


Predictor = Callable[[Bodies], np.ndarray]


def training_mean(bodies: Bodies, log_omega: np.ndarray) -> Predictor:
    """Predict the same frequencies in Hz for all: the mean over the training rows on the mel scale."""
    mean = from_mel(mel(bodies.hertz(log_omega)).mean(axis=0))
    return lambda others: others.log_omega(np.tile(mean, (len(others), 1)))


def material_mean(bodies: Bodies, log_omega: np.ndarray) -> Predictor:
    """Predict the mean over the training rows of the same material on the mel scale; for a new one that over all."""
    mels = mel(bodies.hertz(log_omega))
    means = {name: mels[bodies.material == name].mean(axis=0) for name in np.unique(bodies.material)}
    everything = mels.mean(axis=0)

    def predict(others: Bodies) -> np.ndarray:
        found = np.array([means.get(name, everything) for name in others.material])
        return others.log_omega(from_mel(found))

    return predict


def mean_spectrum(bodies: Bodies, log_omega: np.ndarray) -> Predictor:
    """Predict the mean dimensionless spectrum (geometric), rescaled to each body's size and material."""
    mean = log_omega.mean(axis=0)
    return lambda others: np.tile(mean, (len(others), 1))


def nearest(bodies: Bodies, log_omega: np.ndarray, neighbours: int = NEIGHBOURS) -> Predictor:
    """Predict the mean spectrum of the nearest shapes, weighted by inverse distance.

    Distances are Euclidean in the standardised logarithms of the invariants. The rows of one shape count as one. The
    effect of Poisson's ratio is linear with a slope per mode, fitted on the shapes that occur with several.
    """
    from scipy.spatial import cKDTree

    shapes, member, count = np.unique(
        np.log(bodies.invariants), axis=0, return_inverse=True, return_counts=True
    )
    member = member.ravel()

    def of_shape(values: np.ndarray) -> np.ndarray:
        total = np.zeros((len(shapes), *values.shape[1:]))
        np.add.at(total, member, values)
        return total / count.reshape(-1, *[1] * (values.ndim - 1))

    poisson, spectra = of_shape(bodies.poisson), of_shape(log_omega)
    inside = bodies.poisson - poisson[member]
    varied = inside @ inside
    slope = inside @ (log_omega - spectra[member]) / varied if varied > 0 else np.zeros(log_omega.shape[1])
    centre, width = shapes.mean(axis=0), shapes.std(axis=0)
    width[width == 0] = 1.0
    tree = cKDTree((shapes - centre) / width)
    wanted = list(range(1, min(neighbours, len(shapes)) + 1))

    def predict(others: Bodies) -> np.ndarray:
        distance, found = tree.query((np.log(others.invariants) - centre) / width, k=wanted)
        weight = 1.0 / np.maximum(distance, _MIN_DISTANCE)
        weight /= weight.sum(axis=1, keepdims=True)
        moved = spectra[found] + (others.poisson[:, None] - poisson[found])[:, :, None] * slope
        return np.sort(np.einsum("nk,nkm->nm", weight, moved), axis=1)

    return predict


def extra_trees(bodies: Bodies, log_omega: np.ndarray, seed: int = 0, trees: int = TREES) -> Predictor:
    """Predict all modes with one forest of extremely randomised trees (Geurts et al., Machine Learning 63, 3, 2006)."""
    from sklearn.ensemble import ExtraTreesRegressor

    forest = ExtraTreesRegressor(n_estimators=trees, min_samples_leaf=2, random_state=seed, n_jobs=1)
    forest.fit(_columns(bodies), log_omega)
    return lambda others: np.sort(forest.predict(_columns(others)), axis=1)


def gradient_boosting(
    bodies: Bodies, log_omega: np.ndarray, seed: int = 0, rounds: int = ROUNDS
) -> Predictor:
    """Predict the principal directions of the training spectra, each with gradient-boosted trees.

    Eight directions hold nearly all variance of 64 ascending frequencies and take an eighth of the time of 64 models.
    """
    from sklearn.ensemble import HistGradientBoostingRegressor

    mean = log_omega.mean(axis=0)
    directions = np.linalg.svd(log_omega - mean, full_matrices=False)[2][:_DIRECTIONS]
    columns = _columns(bodies)
    models = [
        HistGradientBoostingRegressor(
            learning_rate=0.05, max_iter=rounds, min_samples_leaf=5, random_state=seed
        ).fit(columns, target)
        for target in directions @ (log_omega - mean).T
    ]

    def predict(others: Bodies) -> np.ndarray:
        seen = _columns(others)
        return np.sort(
            mean + np.stack([model.predict(seen) for model in models], axis=1) @ directions, axis=1
        )

    return predict


def corrected_ritz(bodies: Bodies, log_omega: np.ndarray) -> Predictor:
    """Predict the finest Ritz frequencies, less the mean logarithmic error of each mode."""
    mean = (log_omega - bodies.ritz[:, -1]).mean(axis=0)
    return lambda others: np.sort(others.ritz[:, -1] + mean, axis=1)


def extrapolated_ritz(bodies: Bodies, log_omega: np.ndarray) -> Predictor:
    """Predict the finest Ritz frequencies, less a multiple of the steps that led to them.

    Least squares over all modes of all bodies: how far a frequency still falls follows from how far it has fallen.
    """

    def columns(some: Bodies) -> np.ndarray:
        steps = np.diff(some.ritz, axis=1).transpose(0, 2, 1)
        return np.concatenate([steps, np.ones((*steps.shape[:2], 1))], axis=2)

    seen = columns(bodies)
    error = log_omega - bodies.ritz[:, -1]
    factors = np.linalg.lstsq(seen.reshape(-1, seen.shape[2]), error.ravel(), rcond=None)[0]
    return lambda others: np.sort(others.ritz[:, -1] + columns(others) @ factors, axis=1)


def trees_on_ritz(bodies: Bodies, log_omega: np.ndarray, seed: int = 0, trees: int = TREES) -> Predictor:
    """Predict the error of the Ritz frequencies with a forest of extremely randomised trees.

    It sees what :func:`extra_trees` does, and every fourth mode of all spaces: the finest, and the steps between.
    """
    from sklearn.ensemble import ExtraTreesRegressor

    def columns(some: Bodies) -> np.ndarray:
        modes = some.ritz[:, :, ::4]
        steps = np.diff(modes, axis=1).reshape(len(some), -1)
        return np.column_stack([_columns(some), modes[:, -1], steps])

    forest = ExtraTreesRegressor(n_estimators=trees, min_samples_leaf=2, random_state=seed, n_jobs=1)
    forest.fit(columns(bodies), log_omega - bodies.ritz[:, -1])
    return lambda others: np.sort(others.ritz[:, -1] + forest.predict(columns(others)), axis=1)


#: The baselines by name.
BASELINES: dict[str, Callable[[Bodies, np.ndarray], Predictor]] = {
    "training mean": training_mean,
    "material mean": material_mean,
    "mean spectrum": mean_spectrum,
    "nearest shapes": nearest,
    "extra trees": extra_trees,
    "gradient boosting": gradient_boosting,
    "finest Ritz, mean correction": corrected_ritz,
    "finest Ritz, extrapolated": extrapolated_ritz,
    "extra trees on Ritz": trees_on_ritz,
}


def _columns(bodies: Bodies) -> np.ndarray:
    """Return the inputs of trees (n, 7): logarithms of invariants and thinness, Poisson's ratio.

    E, ρ and volume are left out because the dimensionless frequencies do not depend on them.
    """
    logarithms = np.log(np.column_stack([bodies.invariants, thinness(bodies.invariants)]))
    return np.column_stack([logarithms, bodies.poisson])
