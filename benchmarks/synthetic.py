"""Features of random smooth bodies with invented spectra, for benchmarks of training that have no dataset.

Arrays have the sizes of real ones. A spectrum follows from a body's three sides, so a network can learn something.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from vibraverse.config.learn import Features, Learn
from vibraverse.contract.seeds import rng
from vibraverse.learn.task import Task
from vibraverse.learn.tasks import task_at

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/learn"))
import make_features

_FAMILIES = ("bar", "bowl", "cup", "mug", "pan", "ring", "rod", "vase")


def write(folder: Path, objects: int, options: Features) -> list[Path]:
    """Write the features of objects with both bodies, and ``splits.tsv``; return the records of the features."""
    names = [f"{_FAMILIES[number % len(_FAMILIES)]}-{number:04d}" for number in range(objects)]
    invented = {"invented_ritz": True, "reconstruction": False}
    make_features.write(folder / "00000", names, options=options, surface=_smooth, modes=64, **invented)
    make_features.write_splits(folder / "splits.tsv", names)
    return records(folder)


def records(folder: Path) -> list[Path]:
    """Return the records of the features in a folder, which has ``splits.tsv`` beside them."""
    return sorted(folder.glob("*/features.json"))


def task(folder: Path, name: str, model: str, preset: str, **training) -> Task:
    """Return a task over the features in a folder, with a preset and the keys of ``training`` that differ from it."""
    points = 512 if preset == "tiny" else 4096
    learn = Learn(preset=preset, features=Features(points=points), **{name: {"training": training}})
    return task_at(records(folder), folder / "splits.tsv", learn.run(name, "object", model, 0))


def _smooth(object_: str, solidity: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface of an ellipsoid with waves on it, and with the same shape inside if it is hollow."""
    sphere, faces = _sphere()
    random = rng(object_, "waves")
    radius = 1.0 + sum(
        0.08 * np.sin(sphere @ random.normal(size=3) * 3 + random.uniform(0, 6)) for _ in range(3)
    )
    vertices = sphere * radius[:, None] * make_features.sides_of(object_) / 2
    vertices *= 0.9 / np.abs(vertices).max()
    if solidity == "solid":
        return vertices, faces
    inside = 0.6 * vertices
    return np.concatenate([vertices, inside]), np.concatenate([faces, faces[:, ::-1] + len(vertices)])


@cache
def _sphere(count: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Return points on a sphere in a spiral, and its triangles, counter-clockwise outside."""
    heights = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turns = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    flat = np.sqrt(1.0 - heights**2)
    points = np.stack([flat * np.cos(turns), flat * np.sin(turns), heights], axis=1)
    faces = ConvexHull(points).simplices
    inward = np.linalg.det(points[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces
