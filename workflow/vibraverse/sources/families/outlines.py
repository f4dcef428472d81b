"""Random flat outlines (N, 2): smooth, cornered and thin-walled ones."""

from __future__ import annotations

import numpy as np

from vibraverse.geometry.planar import soften, subtract, unite
from vibraverse.geometry.profiles import circle, polygon, rounded


def lumpy(random: np.random.Generator, waves: int = 4, depth: float = 0.3, n: int = 120) -> np.ndarray:
    """A smooth outline about the origin, its mean radius 1, by a few waves of its radius; never folded."""
    theta = 2 * np.pi * np.arange(n) / n
    radius = np.ones(n)
    for k in range(2, 2 + int(random.integers(1, waves + 1))):
        radius += depth / k * random.uniform(-1, 1) * np.cos(k * theta + random.uniform(0, 2 * np.pi))
    return np.stack([np.cos(theta), np.sin(theta)], axis=1) * radius[:, None]


def sheet(random: np.random.Generator) -> np.ndarray:
    """The outline of a plate: a rectangle, an ellipse, a polygon, a lump; longest side about 2."""
    kind = random.integers(4)
    width = random.uniform(0.3, 1.0)
    if kind == 0:
        return rounded(-1.0, 1.0, -width, width, random.uniform(0.05, 0.9) * width)
    if kind == 1:
        return circle((0.0, 0.0), 1.0, 80) * [1.0, width]
    if kind == 2:
        corners = polygon(int(random.integers(3, 9)), 0.8) * [1.0, max(width, 0.6)]
        return soften([corners], 0.0, random.uniform(0.02, 0.15))[0]
    return lumpy(random, depth=0.5) * [1.0, max(width, 0.5)]


def section(random: np.random.Generator) -> list[np.ndarray]:
    """The section of a bar: solid, of thin walls, or hollow; longest side about 1; the outer outline first."""
    made = _SECTIONS[random.integers(len(_SECTIONS))](random)
    flat = [1.0, random.uniform(0.6, 1.0)]
    return [ring * flat for ring in made]


def _solid(random: np.random.Generator) -> list[np.ndarray]:
    kind = random.integers(3)
    if kind == 0:
        half = random.uniform(0.12, 0.5)
        return [rounded(-0.5, 0.5, -half, half, random.uniform(0.05, 0.9) * half)]
    if kind == 1:
        return [polygon(int(random.integers(3, 8)), 0.42)]
    return [0.45 * lumpy(random, depth=0.6)]


def _walls(random: np.random.Generator) -> list[np.ndarray]:
    """One to four walls that meet: an L, a T, a U, a cross, or what else comes of it."""
    half = random.uniform(0.07, 0.13)
    across = random.uniform(0.3, 0.5)
    parts = [rounded(-0.5, 0.5, -half, half, 0.3 * half)]
    for _ in range(int(random.integers(1, 3))):
        x = random.choice([-0.5 + half, 0.0, 0.5 - half])
        low, high = [(-across, half), (-half, across), (-across, across)][random.integers(3)]
        parts.append(rounded(x - half, x + half, low, high, 0.3 * half))
    return soften(unite(*parts), 0.4 * half, 0.2 * half)[:1]


def _tube(random: np.random.Generator) -> list[np.ndarray]:
    outer = [polygon(int(random.integers(3, 7)), 0.42), circle((0.0, 0.0), 0.5), 0.45 * lumpy(random)]
    outline = soften([outer[random.integers(3)]], 0.0, 0.05)[0]
    return subtract(outline, outline * random.uniform(0.4, 0.65))


_SECTIONS = (_solid, _walls, _tube)
