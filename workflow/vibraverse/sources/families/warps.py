"""Maps of space (N, 3) -> (N, 3) that fold nothing: taper, twist, bend, lobes.

Each is one to one wherever its bounds hold, so it takes a body without self-intersection to another one.
"""

from __future__ import annotations

import numpy as np


def taper(points: np.ndarray, end: float, curve: float) -> np.ndarray:
    """Scale sections along z, by 1 at the lower end to ``end`` > 0 at the upper one; ``curve`` bends the way there."""
    low, high = points[:, 2].min(), points[:, 2].max()
    share = (points[:, 2] - low) / (high - low)
    scale = 1.0 + (end - 1.0) * share**curve
    return np.column_stack([points[:, :2] * scale[:, None], points[:, 2]])


def twist(points: np.ndarray, turns: float) -> np.ndarray:
    """Turn sections about z, by ``turns`` full turns from the lower end to the upper one."""
    low, high = points[:, 2].min(), points[:, 2].max()
    return turn(points, 2 * np.pi * turns * (points[:, 2] - low) / (high - low))


def turn(points: np.ndarray, angle: float | np.ndarray) -> np.ndarray:
    """Turn about z by an angle in radians, one for all or one per point."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = points.T
    return np.stack([c * x - s * y, s * x + c * y, z], axis=1)


def bend(points: np.ndarray, angle: float) -> np.ndarray:
    """Bend z towards x, by ``angle`` radians in all; the length of the middle line stays.

    One to one while x stays below the bending radius, which is the length over the angle, and the ends do not meet.
    """
    low, high = points[:, 2].min(), points[:, 2].max()
    radius = (high - low) / angle
    along = (points[:, 2] - (low + high) / 2) / radius
    across = radius - points[:, 0]
    return np.stack([radius - across * np.cos(along), points[:, 1], across * np.sin(along)], axis=1)


def most_bend(points: np.ndarray, share: float) -> float:
    """Return the angle in radians at which x reaches ``share`` of the bending radius somewhere."""
    return share * float(np.ptp(points[:, 2]) / max(points[:, 0].max(), 1e-9))


def lobes(points: np.ndarray, count: int, depth: float) -> np.ndarray:
    """Scale sections by ``1 + depth cos(count θ)`` about z, with ``depth`` < 1."""
    theta = np.arctan2(points[:, 1], points[:, 0])
    scale = 1.0 + depth * np.cos(count * theta)
    return np.column_stack([points[:, :2] * scale[:, None], points[:, 2]])


def waves(points: np.ndarray, waves: list[tuple[np.ndarray, float, float]]) -> np.ndarray:
    """Shift points along z by waves over x and y, each ``(wave vector (2,), phase, height)``, heights as z's.

    The shift is the same above and below. Thickness along z grows with the slope, so that across the sheet it stays.
    """
    shift, slope = np.zeros(len(points)), np.zeros((len(points), 2))
    for vector, phase, height in waves:
        angle = points[:, :2] @ vector + phase
        shift += height * np.sin(angle)
        slope += height * np.cos(angle)[:, None] * vector
    steep = np.sqrt(1.0 + (slope**2).sum(axis=1))
    return np.column_stack([points[:, :2], points[:, 2] * steep + shift])
