"""Simple solids in random proportions and directions: what open-ended families are made of.

Every solid is centred near the origin, its longest side about 1, and no side is shorter than a quarter.
"""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from vibraverse.geometry.profiles import polygon

#: Segments of a full circle.
_SEGMENTS = 40


def rotation(random: np.random.Generator) -> np.ndarray:
    """Return a rotation (3, 3) drawn evenly from all rotations."""
    w, x, y, z = (quaternion := random.normal(size=4)) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def direction(random: np.random.Generator) -> np.ndarray:
    """Return a unit vector (3,) drawn evenly from all directions."""
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)


def turned_to(axis: np.ndarray, spin: float) -> np.ndarray:
    """Return a rotation (3, 3) that takes the z axis to a unit vector; ``spin`` (radians) is the angle about it."""
    side = np.eye(3)[np.argmin(np.abs(axis))]
    x = np.cross(side, axis)
    x /= np.linalg.norm(x)
    y = np.cross(axis, x)
    c, s = np.cos(spin), np.sin(spin)
    return np.stack([c * x + s * y, c * y - s * x, axis], axis=1)


def moved(part: Manifold, turn: np.ndarray, shift) -> Manifold:
    """Return a solid rotated by a matrix (3, 3), then shifted by a vector (3,)."""
    return part.transform(np.column_stack([turn, shift]))


def box(random: np.random.Generator) -> Manifold:
    """A box of random sides."""
    return Manifold.cube(list(_sides(random)), center=True)


def ball(random: np.random.Generator) -> Manifold:
    """A ball, or an ellipsoid."""
    sides = _sides(random) if random.random() < 0.5 else np.ones(3)
    return Manifold.sphere(0.5, _SEGMENTS).scale(list(sides))


def cylinder(random: np.random.Generator) -> Manifold:
    """A disc, a cylinder or a rod."""
    width, height = _two(random)
    return Manifold.cylinder(height, width / 2, circular_segments=_SEGMENTS, center=True)


def cone(random: np.random.Generator) -> Manifold:
    """A cone without its tip."""
    width, height = _two(random)
    top = random.uniform(0.3, 0.7) * width / 2
    return Manifold.cylinder(height, width / 2, top, _SEGMENTS, center=True)


def torus(random: np.random.Generator) -> Manifold:
    """A ring of round section."""
    radius = random.uniform(0.12, 0.19)
    circle = CrossSection.circle(radius, 20).translate([0.5 - radius, 0.0])
    return Manifold.revolve(circle, _SEGMENTS)


def prism(random: np.random.Generator) -> Manifold:
    """A prism of three to six sides."""
    width, height = _two(random)
    outline = polygon(int(random.integers(3, 7)), 0.45 * width)
    return Manifold.extrude(CrossSection([outline]), height).translate([0, 0, -height / 2])


def capsule(random: np.random.Generator) -> Manifold:
    """A rod with round ends."""
    radius = random.uniform(0.14, 0.3)
    tip = Manifold.sphere(radius, _SEGMENTS)
    return Manifold.batch_hull([tip.translate([0, 0, z]) for z in (radius - 0.5, 0.5 - radius)])


_ALL = (box, ball, cylinder, cone, torus, prism, capsule)


def primitive(random: np.random.Generator) -> Manifold:
    """Draw one of all kinds."""
    return _ALL[random.integers(len(_ALL))](random)


def _sides(random: np.random.Generator) -> np.ndarray:
    """Draw three sides between 0.25 and 1, in any order; the longest is 1."""
    return random.permutation(np.array([1.0, *np.exp(random.uniform(np.log(0.25), 0.0, size=2))]))


def _two(random: np.random.Generator) -> np.ndarray:
    return random.permutation(np.array([1.0, np.exp(random.uniform(np.log(0.25), 0.0))]))
