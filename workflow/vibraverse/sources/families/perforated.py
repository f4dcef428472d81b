"""Open-ended family of bodies full of holes: plates, blocks, tubes, balls and hollow balls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold, OpType

from vibraverse.geometry.planar import distance, inside
from vibraverse.geometry.profiles import circle, polygon, turned
from vibraverse.sources.families.outlines import lumpy, sheet
from vibraverse.sources.families.primitives import direction, moved, turned_to
from vibraverse.sources.families.redraw import OpenShape
from vibraverse.sources.families.shape import between, one_of

#: Tries per hole to find a place; holes without one are left out.
_TRIES = 12
#: Least width of what stays between holes, in longest sides.
_WEB = 0.06
_SEGMENTS = 64
#: Holes of a ball stay this close to an axis, in diameters.
_DRILLED = 0.4
_SQUARE = 0.5 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


@dataclass(frozen=True)
class Perforated(OpenShape):
    """A plate, block, tube or ball with a random pattern of holes."""

    size_range_m = (0.05, 0.4)
    kind: str = one_of("plate", "plate", "block", "tube", "ball", "shell")
    holes: int = between(2, 24)
    hole: float = between(0.06, 0.16)
    spread: float = between(0.0, 0.5)
    form: str = one_of("round", "round", "cornered", "long", "mixed")

    def body(self, random: np.random.Generator) -> Manifold | None:
        """Draw the body and subtract what holes find a place; a body without a hole is drawn again."""
        return getattr(self, f"_{self.kind}")(random)

    def _plate(self, random: np.random.Generator) -> Manifold | None:
        """A flat plate of half a unit and its holes."""
        outline = 0.5 * sheet(random)
        thickness = random.uniform(0.055, 0.2)
        return self._drilled(random, outline, thickness)

    def _block(self, random: np.random.Generator) -> Manifold | None:
        """A block drilled along up to three axes; holes may meet inside."""
        sides = _sides(random)
        return self._through(random, Manifold.cube(list(sides), center=True), sides, _SQUARE)

    def _ball(self, random: np.random.Generator) -> Manifold | None:
        """A ball or an ellipsoid drilled where its surface is steep enough to leave no sharp edges."""
        sides = _sides(random)
        ball = Manifold.sphere(0.5, _SEGMENTS).scale(list(sides))
        return self._through(random, ball, sides, circle((0.0, 0.0), _DRILLED, 32))

    def _through(self, random: np.random.Generator, whole: Manifold, sides, face) -> Manifold | None:
        """Drill a body within a box of these ``sides``; ``face`` is its outline along an axis, in sides."""
        drilled = whole
        for axis in random.permutation(3)[: random.integers(1, 4)]:
            others = [(axis + 1) % 3, (axis + 2) % 3]
            for hole in self._holes(random, _dense(face * sides[others])):
                bar = Manifold.extrude(CrossSection([hole]), 2.0).translate([0, 0, -1.0])
                drilled -= moved(bar, np.eye(3)[:, [*others, axis]], np.zeros(3))
        return drilled if drilled.volume() < 0.99 * whole.volume() else None

    def _tube(self, random: np.random.Generator) -> Manifold | None:
        """A tube with holes in its wall: a drilled sheet, rolled up."""
        radius, height = random.uniform(0.15, 0.5), random.uniform(0.4, 1.0)
        wall = random.uniform(0.06, 0.3 * radius + 0.03)
        tube = Manifold.cylinder(height, radius, circular_segments=_SEGMENTS, center=True)
        tube -= Manifold.cylinder(2.0, radius - wall, circular_segments=_SEGMENTS, center=True)
        width = np.pi * radius
        face = np.array(
            [(-width, -height / 2), (width, -height / 2), (width, height / 2), (-width, height / 2)]
        )
        holes = self._holes(random, _dense(face))
        for hole in holes:
            x, z = hole.mean(axis=0)
            turn = turned_to(np.array([np.cos(x / radius), np.sin(x / radius), 0.0]), 0.0)
            tube -= moved(Manifold.extrude(CrossSection([hole - (x, z)]), 1.0), turn, [0, 0, z])
        return tube if holes else None

    def _shell(self, random: np.random.Generator) -> Manifold | None:
        """A hollow ball or ellipsoid with holes towards its middle."""
        ball = Manifold.sphere(0.5, _SEGMENTS) - Manifold.sphere(0.5 - random.uniform(0.06, 0.14), _SEGMENTS)
        axes: list[tuple[np.ndarray, float]] = []
        for _ in range(_TRIES * self.holes):
            axis, radius = direction(random), self._radius(random)
            apart = [np.arccos(np.clip(axis @ other, -1, 1)) * 0.5 - r for other, r in axes]
            if len(axes) < self.holes and min(apart, default=1.0) > radius + _WEB:
                axes.append((axis, radius))
        for axis, radius in axes:
            hole = self._hole(random, radius)
            ball -= moved(Manifold.extrude(CrossSection([hole]), 1.0), turned_to(axis, 0.0), np.zeros(3))
        flat = [1.0, 1.0, random.uniform(0.6, 1.0)]
        return ball.scale(flat) if axes else None

    def _drilled(self, random: np.random.Generator, outline: np.ndarray, thickness: float) -> Manifold | None:
        holes = self._holes(random, _dense(outline))
        if not holes:
            return None
        plate = CrossSection([outline]) - CrossSection.batch_boolean(
            [CrossSection([hole]) for hole in holes], OpType.Add
        )
        return Manifold.extrude(plate, thickness)

    def _holes(self, random: np.random.Generator, outline: np.ndarray) -> list[np.ndarray]:
        """Draw outlines of holes in a flat region; each keeps its distance from the border and from the others."""
        low, high = outline.min(axis=0), outline.max(axis=0)
        found: list[tuple[np.ndarray, float]] = []
        for _ in range(_TRIES * self.holes):
            centre, radius = random.uniform(low, high), self._radius(random)
            free = [np.linalg.norm(centre - other) - r for other, r in found]
            if len(found) == self.holes or min(free, default=1.0) < radius + _WEB:
                continue
            if inside(centre[None], [outline])[0] and distance(centre[None], outline)[0] > radius + _WEB:
                found.append((centre, radius))
        return [self._hole(random, radius) + centre for centre, radius in found]

    def _radius(self, random: np.random.Generator) -> float:
        return self.hole * float(np.exp(self.spread * random.uniform(-1, 1)))

    def _hole(self, random: np.random.Generator, radius: float) -> np.ndarray:
        """Draw the outline of a hole within a circle."""
        form = self.form if self.form != "mixed" else random.choice(["round", "cornered", "long", "lumpy"])
        turn = random.uniform(0, 360)
        if form == "cornered":
            sides = int(random.integers(3, 7))
            return turned(polygon(sides, radius * np.cos(np.pi / sides)), turn)
        if form == "long":
            return turned(circle((0.0, 0.0), radius, 32) * [1.0, random.uniform(0.45, 0.8)], turn)
        if form == "lumpy":
            return 0.75 * radius * lumpy(random, n=40)
        return circle((0.0, 0.0), radius, 32)


def _sides(random: np.random.Generator) -> np.ndarray:
    """Draw the sides (3,) of a box in any order; the longest is 1."""
    return random.permutation([1.0, *random.uniform(0.4, 1.0, size=2)])


def _dense(outline: np.ndarray, step: float = 0.02) -> np.ndarray:
    """Return an outline with points at most a step apart, so that distances to them are those to the outline."""
    ends = np.roll(outline, -1, axis=0)
    pieces = []
    for a, b in zip(outline, ends, strict=True):
        n = max(1, int(np.ceil(np.linalg.norm(b - a) / step)))
        pieces.append(a + np.linspace(0, 1, n, endpoint=False)[:, None] * (b - a))
    return np.concatenate(pieces)
