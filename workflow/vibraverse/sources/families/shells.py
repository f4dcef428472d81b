"""Open-ended families of thin and thick shells: turned walls, wavy plates, blends with an opening."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from vibraverse.geometry.planar import half_plane
from vibraverse.geometry.profiles import extrude, revolve, wall
from vibraverse.sources.families import warps
from vibraverse.sources.families.blended import blended
from vibraverse.sources.families.fields import level_set, soft_cut
from vibraverse.sources.families.outlines import sheet
from vibraverse.sources.families.primitives import direction
from vibraverse.sources.families.redraw import OpenShape, warped
from vibraverse.sources.families.shape import between, one_of
from vibraverse.sources.families.solids import solid
from vibraverse.sources.families.turned import SPACING, midline, off_round

#: Cells of the grid of a blend along its longest side.
_CELLS = 44
#: A bent plate turns by at most this many radians.
_MOST_TURN = 3.6


@dataclass(frozen=True)
class Shell(OpenShape):
    """A shell: turned, a wavy or bent plate, or a blend with an opening."""

    size_range_m = (0.05, 0.4)
    ridge_deg = 40.0
    kind: str = one_of("turned", "turned", "plate", "plate", "blend")
    nodes: int = between(2, 6)
    thickness: float = between(0.06, 0.12)

    def body(self, random: np.random.Generator) -> Manifold | None:
        """Draw a shell whose walls are ``thickness`` thick, in about its longest side."""
        if self.kind == "turned":
            return self._turned(random)
        return self._plate(random) if self.kind == "plate" else self._blend(random)

    def _turned(self, random: np.random.Generator) -> Manifold | None:
        """Revolve a wall about a random midline: closed at the axis as a bowl, or open at both ends."""
        start = 0.0 if random.random() < 0.6 else random.uniform(0.3, 1.0)
        line = midline(random, self.nodes, start)
        if line[1:, 0].min() < 0.1 * start:
            return None
        extent = max(2 * line[:, 0].max(), float(np.ptp(line[:, 1])))
        profile = self.thickness * extent * random.uniform(0.8, 1.25, size=3)
        thickness = np.interp(np.linspace(0, 2, len(line)), range(3), profile)
        outline = wall(line, thickness)
        outline = half_plane(outline) if start == 0 else outline
        if outline[:, 0].min() < 0:
            return None
        return solid(off_round(random, revolve(outline, SPACING * extent)))

    def _plate(self, random: np.random.Generator) -> Manifold | None:
        """Cut a plate, lay waves over it, and perhaps bend it to a channel."""
        thickness = 2 * self.thickness
        vertices, faces = extrude([sheet(random)], thickness, 0.06)
        waves = [self._wave(random) for _ in range(self.nodes)] if random.random() < 0.7 else []
        vertices = warps.waves(vertices, waves)
        if not waves or random.random() < 0.5:
            upright = vertices[:, [2, 1, 0]] * [1.0, -1.0, 1.0]  # z along the plate, x across it
            angle = min(_MOST_TURN, warps.most_bend(upright, 0.7)) * random.uniform(0.3, 1.0)
            return warped((upright, faces), lambda points: warps.bend(points, angle))
        return solid((vertices, faces))

    def _wave(self, random: np.random.Generator) -> tuple[np.ndarray, float, float]:
        number, angle = random.uniform(1.0, 4.0), random.uniform(0, 2 * np.pi)
        vector = number * np.array([np.cos(angle), np.sin(angle)])
        height = random.uniform(0.3, 1.0) * 0.7 / (number * np.sqrt(self.nodes))
        return vector, random.uniform(0, 2 * np.pi), float(height)

    def _blend(self, random: np.random.Generator) -> Manifold | None:
        """Keep the outermost layer of a blend and cut one side open."""
        field, low, high = blended(random, self.nodes, 0.0, random.uniform(0.1, 0.3))
        wall = 1.2 * self.thickness * float((high - low).max()) / 1.5
        away, share = direction(random), random.uniform(-0.1, 0.6)

        def shell(points: np.ndarray) -> np.ndarray:
            values = field(points)
            reach = (points[values < 0] @ away).max()
            opening = share * reach - points @ away
            return soft_cut(np.abs(values + wall / 2) - wall / 2, opening, 0.3 * wall)

        return level_set(shell, low, high, _CELLS)
