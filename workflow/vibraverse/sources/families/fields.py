"""Smooth bodies as level sets: signed distances of simple solids, soft unions and cuts, and their surfaces.

A field maps points (N, 3) to signed distances (N,), negative inside. Those of blends are too small rather than too
large.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold

Field = Callable[[np.ndarray], np.ndarray]


def ball(size: np.ndarray) -> Field:
    """A ball of radius ``size[0]``."""
    return lambda p: np.linalg.norm(p, axis=1) - size[0]


def rounded_box(size: np.ndarray) -> Field:
    """A box with half sides ``size`` (3,), its edges rounded by a third of the shortest."""
    radius = size.min() / 3

    def distance(p: np.ndarray) -> np.ndarray:
        q = np.abs(p) - (size - radius)
        return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0) - radius

    return distance


def capsule(size: np.ndarray) -> Field:
    """A rod along z with round ends: radius the smaller of ``size[:2]``, half length ``size[2]`` between the ends."""
    radius = size[:2].min()

    def distance(p: np.ndarray) -> np.ndarray:
        along = np.clip(p[:, 2], -size[2], size[2])
        return np.linalg.norm(np.column_stack([p[:, :2], p[:, 2] - along]), axis=1) - radius

    return distance


def torus(size: np.ndarray) -> Field:
    """A ring about z: radius ``size[0]`` to its middle line, which is a third as thick or more."""
    radius = max(0.35 * size[0], 0.3 * size[1])

    def distance(p: np.ndarray) -> np.ndarray:
        return np.hypot(np.hypot(p[:, 0], p[:, 1]) - size[0], p[:, 2]) - radius

    return distance


def disc(size: np.ndarray) -> Field:
    """A cylinder about z with radius ``size[0]`` and half height ``size[2]``, its edges rounded."""
    radius = 0.3 * min(size[0], size[2])

    def distance(p: np.ndarray) -> np.ndarray:
        q = np.stack([np.hypot(p[:, 0], p[:, 1]) - size[0], np.abs(p[:, 2]) - size[2]], axis=1) + radius
        return np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0) - radius

    return distance


KINDS = (ball, ball, rounded_box, capsule, torus, disc)


def placed(field: Field, turn: np.ndarray, shift: np.ndarray) -> Field:
    """Return the field of a body rotated by a matrix (3, 3), then shifted by a vector (3,)."""
    return lambda p: field((p - shift) @ turn)


def soft_union(a: np.ndarray, b: np.ndarray, blend: float) -> np.ndarray:
    """Return the distances of a union whose seam is filleted over a length ``blend``."""
    overlap = np.maximum(blend - np.abs(a - b), 0.0) / blend
    return np.minimum(a, b) - 0.25 * blend * overlap**2


def soft_cut(a: np.ndarray, b: np.ndarray, blend: float) -> np.ndarray:
    """Return the distances of the first body without the second, the edge rounded over a length ``blend``."""
    return -soft_union(-a, b, blend)


def level_set(field: Field, low: np.ndarray, high: np.ndarray, cells: int) -> Manifold:
    """Return the solid where a field is negative inside a box whose longest side has ``cells`` cells.

    manifold3d asks for one value after the other. A first pass notes the points, so that the field is computed for all
    at once, and a second one looks the values up.
    """
    points: list[tuple[float, float, float]] = []

    def note(x: float, y: float, z: float) -> float:
        points.append((x, y, z))
        return -1.0

    box, step = [*low, *high], float((high - low).max()) / cells
    Manifold.level_set(note, box, step)
    values = dict(zip(points, (-field(np.array(points))).tolist(), strict=True))
    return Manifold.level_set(lambda x, y, z: values[x, y, z], box, step)
