"""Pools of bodies in which one of sound, picture and shape is looked for by another, and what is right in them.

An entry of a pool is a body in one material, with its sound, one picture and its shape. Both bodies of an object look
alike and pictures show no material. So with a picture on either side all bodies of the object are right, and those of
its copies; between sound and shape that body alone. (Solid bodies of copies are one body; hollow ones are not, because
each object draws its own cavity.)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from vibraverse.contract.seeds import rng
from vibraverse.learn.ranking import measures, resampled, summary
from vibraverse.learn.samples import Samples

MODALITIES = ("sound", "image", "shape")
#: What is asked with, and what is looked for.
DIRECTIONS = tuple((one, other) for one in MODALITIES for other in MODALITIES if one != other)
#: A pool of fewer bodies says nothing: all of it is among the first ten.
SMALLEST = 10
#: Size of the pools that are drawn, and how many are.
DRAWN, POOLS = 100, 50
#: Sources of the rows: all bodies in one pool, drawn pools, all bodies in the same material for each material.
ALL, SOME, SAME = "all", f"pools of {DRAWN}", "one material"


def alike(samples: Samples) -> dict[str, np.ndarray]:
    """Return numbers (n,) of all bodies: ``look`` is equal for those that look alike, ``body`` for equal bodies."""
    own = np.where(samples.solidity == "solid", samples.original, samples.object)
    bodies = [f"{one} {solidity}" for one, solidity in zip(own, samples.solidity, strict=True)]
    numbers = (np.unique(names, return_inverse=True)[1].ravel() for names in (samples.original, bodies))
    return dict(zip(("look", "body"), numbers, strict=True))


def key_of(direction: tuple[str, str]) -> str:
    """Return which number of :func:`alike` is equal for what is right."""
    return "look" if "image" in direction else "body"


def in_direction(
    found: Mapping[str, np.ndarray], numbers: Mapping[str, np.ndarray], direction: tuple[str, str]
) -> dict[str, np.ndarray]:
    """Return the measures (n,) of every body of a pool as a query; ``found`` maps modalities to vectors (n, d)."""
    own = numbers[key_of(direction)]
    return measures(found[direction[0]], found[direction[1]], own[:, None] == own)


def judge_retrieval(samples: Samples, bodies: np.ndarray, answers: Mapping[str, np.ndarray]) -> list[dict]:
    """Return the rows of answers about bodies (n,), see :mod:`vibraverse.learn.judging`.

    ``answers`` hold the vectors of each modality (n, materials, d), or (n, 1, d) where they do not depend on the
    material, and ``material`` (n,), that of each body where a pool holds several. Measures are named
    ``sound_to_shape_top_1``; ``mean_top_1`` is the mean over all directions. A pool of fewer than
    :data:`SMALLEST` bodies has its size as its only row.
    """
    rows = [{"source": ALL, "measure": "pool", "value": len(bodies), "count": len(bodies)}]
    if len(bodies) < SMALLEST:
        return rows
    objects, numbers = samples.object[bodies], {name: own[bodies] for name, own in alike(samples).items()}
    for source, pools in _pools(objects, answers["material"], len(samples.materials)).items():
        found: dict[tuple[str, str], list] = {direction: [] for direction in DIRECTIONS}
        for chosen, material in pools:
            vectors = {name: _in_material(answers[name][chosen], material) for name in MODALITIES}
            own = {name: values[chosen] for name, values in numbers.items()}
            for direction, parts in found.items():
                parts.append(in_direction(vectors, own, direction))
        asked = np.concatenate([objects[chosen] for chosen, _ in pools])
        rows += [{"source": source, "count": len(bodies), **row} for row in _rows(found, asked)]
    return rows


def _pools(objects: np.ndarray, material: np.ndarray, materials: int) -> dict[str, list[tuple]]:
    """Return by source the pools: the bodies in each, by number, and the material of each."""
    everything = np.arange(len(objects))
    pools = {ALL: [(everything, material)]}
    if len(objects) >= DRAWN:
        drawn = [draw(objects, rng("pool", str(number))) for number in range(POOLS)]
        pools[SOME] = [(chosen, material[chosen]) for chosen in drawn]
    pools[SAME] = [(everything, np.full(len(objects), number)) for number in range(materials)]
    return pools


def draw(objects: np.ndarray, random: np.random.Generator, count: int = DRAWN) -> np.ndarray:
    """Return the numbers (count,) of bodies drawn at random, of as many ``objects`` (n,) as there are."""
    order = random.permutation(len(objects))
    seen: dict[str, int] = {}
    turns = []
    for object_ in objects[order]:
        turns.append(seen.get(object_, 0))
        seen[object_] = turns[-1] + 1
    return order[np.argsort(turns, kind="stable")[:count]]


def _in_material(vectors: np.ndarray, material: np.ndarray) -> np.ndarray:
    """Return the vectors (n, d) of bodies, each in its material (n,)."""
    return vectors[np.arange(len(vectors)), np.minimum(material, vectors.shape[1] - 1)]


def _rows(found: Mapping[tuple[str, str], list[dict]], objects: np.ndarray) -> Iterator[dict]:
    """Yield a row for every direction and measure, then those of the means over directions."""
    values, draws = [], []
    for (one, other), parts in found.items():
        joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        values.append(summary(joined))
        draws.append(resampled(joined, objects))
        for name, value in values[-1].items():
            yield _row(f"{one}_to_{other}_{name}", value, draws[-1][name])
    for name in values[0]:
        mean = float(np.mean([one[name] for one in values]))
        yield _row(f"mean_{name}", mean, np.mean([one[name] for one in draws], axis=0))


def _row(measure: str, value: float, draws: np.ndarray) -> dict:
    low, high = np.percentile(draws, [2.5, 97.5])
    return {"measure": measure, "value": value, "low": float(low), "high": float(high)}
