"""Baselines of retrieval: what chance, the material, linear correlations and approximate frequencies find.

Each gives the vectors of :func:`vibraverse.learn.pools.judge_retrieval`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vibraverse.learn.pools import MODALITIES

#: Directions of each modality that are correlated, and side of the grey pictures that they are taken from, in pixels.
_DIRECTIONS, _PIXELS = 8, 16

Vectors = dict[str, np.ndarray]


def chance(bodies: int) -> Vectors:
    """Return vectors (n, 1, 1) that are the same for all."""
    return {name: np.zeros((bodies, 1, 1)) for name in MODALITIES}


def material_oracle(bodies: int, materials: int) -> Vectors:
    """Return vectors (n, materials, materials) that are the material, for pictures too, and nothing else."""
    return {name: np.tile(np.eye(materials), (bodies, 1, 1)) for name in MODALITIES}


def spectrum_match(true_hz: np.ndarray, found_hz: np.ndarray) -> Vectors:
    """Return vectors whose products are distances between spectra (n, materials, m): of sounds, and of approximations.

    A score is minus half the squared distance between the logarithms. Pictures get nothing.
    """
    sound, shape = np.log(true_hz), np.log(found_hz)
    middle = sound.mean()
    sound, shape = sound - middle, shape - middle
    return {
        "sound": _with_columns(sound, -0.5 * np.square(sound).sum(axis=-1), 1.0),
        "image": np.zeros((len(sound), 1, sound.shape[-1] + 2)),
        "shape": _with_columns(shape, 1.0, -0.5 * np.square(shape).sum(axis=-1)),
    }


def _with_columns(values: np.ndarray, *columns) -> np.ndarray:
    wide = [np.broadcast_to(column, values.shape[:-1])[..., None] for column in columns]
    return np.concatenate([values, *wide], axis=-1)


def canonical_correlations(samples, trained: np.ndarray) -> Callable[[np.ndarray], Vectors]:
    """Fit linear canonical correlations of each pair of modalities on bodies; return what gives the vectors of others.

    A sound is the logarithms of its frequencies, their mean apart; a shape its invariants and which material it is of;
    a picture its grey pixels: the main directions of each. A pair has a block of the vectors; scores are cosines, in
    which a canonical direction counts as much as its correlation.
    """
    from sklearn.decomposition import PCA
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    known = _columns(samples, trained)
    size = {name: min(_DIRECTIONS, values.shape[-1], len(trained)) for name, values in known.items()}
    reduced = {
        name: make_pipeline(StandardScaler(), PCA(size[name], whiten=True)).fit(_flat(values))
        for name, values in known.items()
    }
    pairs = [("sound", "image"), ("sound", "shape"), ("image", "shape")]
    fitted = {}
    for one, other in pairs:
        first, second = (reduced[name].transform(_flat(known[name])) for name in (one, other))
        # Both have unit covariance, so the canonical directions are the singular ones of what they have in common.
        left, correlation, right = np.linalg.svd(first.T @ second / len(first), full_matrices=False)
        fitted[one, other] = left * np.sqrt(correlation), right.T * np.sqrt(correlation)

    def vectors(bodies: np.ndarray) -> Vectors:
        seen = {
            name: (reduced[name].transform(_flat(values)), values.shape[:2])
            for name, values in _columns(samples, bodies).items()
        }
        blocks: dict[str, list[np.ndarray]] = {name: [] for name in MODALITIES}
        for pair, directions in fitted.items():
            for name in MODALITIES:
                rows, width = len(seen[name][0]), directions[0].shape[1]
                own = (
                    seen[name][0] @ directions[pair.index(name)] if name in pair else np.zeros((rows, width))
                )
                blocks[name].append(_unit(own))
        return {
            name: np.concatenate(parts, axis=1).reshape(*seen[name][1], -1) for name, parts in blocks.items()
        }

    return vectors


def _columns(samples, bodies: np.ndarray) -> Vectors:
    """Return what is known of bodies in every material, by modality (n, materials, k)."""
    logarithms = np.log(samples.rows("frequencies_hz", bodies))
    scale = logarithms.mean(axis=-1, keepdims=True)
    many = logarithms.shape[1]
    invariants = np.log(samples.rows("invariants", bodies)).astype(np.float64)
    materials = np.tile(np.eye(many), (len(bodies), 1, 1))
    return {
        "sound": np.concatenate([scale, logarithms - scale], axis=-1),
        "image": np.repeat(_grey(samples, bodies)[:, None], many, axis=1),
        "shape": np.concatenate([np.repeat(invariants[:, None], many, axis=1), materials], axis=-1),
    }


def _grey(samples, bodies: np.ndarray) -> np.ndarray:
    """Return the first picture (n, k) of bodies in grey, as few pixels."""
    from PIL import Image

    found = []
    for body in bodies:
        picture = Image.fromarray(np.asarray(samples.row("views", int(body))[0])).convert("L")
        found.append(np.asarray(picture.resize((_PIXELS, _PIXELS), Image.Resampling.BOX)).ravel() / 255.0)
    return np.array(found)


def _flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(-1, values.shape[-1])


def _unit(values: np.ndarray) -> np.ndarray:
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
