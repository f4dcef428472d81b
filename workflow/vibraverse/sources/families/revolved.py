"""Shape families that are surfaces of revolution: vessels, bells, gongs, rings.

The largest radius is about 1; shapes are scaled to ``size_m`` later. Most are a wall: a smooth midline with a thickness
of at least about a twentieth of the longest side, joined in the half plane with a foot or a knob.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.geometry import Mesh
from vibraverse.geometry.planar import half_plane
from vibraverse.geometry.profiles import arc, revolve, rounded, smooth_curve, wall
from vibraverse.sources.families.shape import Shape, between


@dataclass(frozen=True)
class Bowl(Shape):
    """An open bowl on a foot ring."""

    size_range_m = (0.09, 0.32)
    depth: float = between(0.55, 0.95)
    foot: float = between(0.34, 0.5)
    fullness: float = between(0.0, 1.0)
    thickness: float = between(0.115, 0.15)

    def build(self) -> Mesh:
        """Revolve a wall with a foot ring."""
        belly = 0.72 + 0.13 * self.fullness
        line = [(0.0, 0.0), (0.45, 0.03), (belly, 0.34 * self.depth), (0.94, 0.7 * self.depth)]
        body = wall(smooth_curve([*line, (1.0, self.depth)]), self.thickness)
        ring = rounded(self.foot - 0.07, self.foot + 0.07, -0.17, 0.02, 0.03)
        return revolve(half_plane(body, ring), 0.05)


@dataclass(frozen=True)
class SingingBowl(Shape):
    """A thick bowl with a flat bottom and a rim that turns inwards."""

    size_range_m = (0.1, 0.3)
    depth: float = between(0.75, 1.05)
    bottom: float = between(0.4, 0.6)
    mouth: float = between(0.8, 0.93)
    thickness: float = between(0.13, 0.18)

    def build(self) -> Mesh:
        """Revolve a wall that thickens to its rim."""
        d = self.depth
        line = [(0.0, 0.0), (self.bottom, 0.02), (0.88, 0.26 * d), (1.0, 0.58 * d), (self.mouth, d)]
        return revolve(wall(smooth_curve(line), np.linspace(1.0, 1.25, 200) * self.thickness), 0.055)


@dataclass(frozen=True)
class Bell(Shape):
    """A bell with a thick sound bow and a crown."""

    size_range_m = (0.07, 0.4)
    height: float = between(1.35, 1.8)
    waist: float = between(0.58, 0.68)
    crown: float = between(0.16, 0.22)
    thickness: float = between(0.115, 0.14)

    def build(self) -> Mesh:
        """Revolve a wall, thickest near its lip, with a ball on top."""
        h, w = self.height, self.waist
        line = [
            (0.0, h),
            (0.32, 0.985 * h),
            (w - 0.09, 0.87 * h),
            (w, 0.5 * h),
            (w + 0.12, 0.2 * h),
            (1.0, 0.0),
        ]
        midline = smooth_curve(line)
        swell = np.exp(-(((np.linspace(0, 1, len(midline)) - 0.93) / 0.09) ** 2))
        body = wall(midline, self.thickness * (1.0 + 0.55 * swell))
        c = self.crown
        crown = arc((0.0, h + c), c, -90, 90, 24)
        stem = np.array([(0.0, h - 0.02), (0.75 * c, h - 0.02), (0.6 * c, h + 0.5 * c), (0.0, h + 0.5 * c)])
        return revolve(half_plane(body, crown, stem), 0.05)


@dataclass(frozen=True)
class Vase(Shape):
    """A vase with a belly, a neck and a lip."""

    size_range_m = (0.12, 0.45)
    height: float = between(2.2, 2.9)
    foot: float = between(0.45, 0.65)
    belly_at: float = between(0.36, 0.56)
    neck: float = between(0.38, 0.55)
    lip: float = between(0.6, 0.8)
    thickness: float = between(0.155, 0.19)

    def build(self) -> Mesh:
        """Revolve a wall."""
        h, at = self.height, self.belly_at
        line = [(0.0, 0.0), (self.foot - 0.1, 0.0), (self.foot + 0.07, 0.1), (0.92, at * h)]
        line += [(self.neck, 0.86 * h), (self.lip, h)]
        return revolve(wall(smooth_curve(line), self.thickness), 0.07)


@dataclass(frozen=True)
class Bottle(Shape):
    """A bottle with shoulders, a neck and a collar."""

    size_range_m = (0.12, 0.33)
    height: float = between(2.9, 3.6)
    shoulder: float = between(0.52, 0.64)
    neck: float = between(0.36, 0.44)
    thickness: float = between(0.185, 0.21)

    def build(self) -> Mesh:
        """Revolve a wall with a collar."""
        h, s, n = self.height, self.shoulder, self.neck
        corner = arc((0.72, 0.28), 0.28, -90, 0, 12)
        shoulder = smooth_curve(
            [(1.0, s * h), (0.93, (s + 0.07) * h), (n + 0.1, (s + 0.17) * h), (n, 0.84 * h)], 60
        )
        line = np.concatenate([[(0.0, 0.0), (0.4, 0.0)], corner, shoulder, [(n, h)]])
        collar = rounded(n - 0.05, n + self.thickness / 2 + 0.09, 0.9 * h, h + self.thickness / 2, 0.05)
        return revolve(half_plane(wall(line, self.thickness), collar), 0.085)


@dataclass(frozen=True)
class Goblet(Shape):
    """A drinking glass with a stem and a foot."""

    size_range_m = (0.13, 0.25)
    stem: float = between(0.75, 1.15)
    stem_radius: float = between(0.115, 0.16)
    cup: float = between(1.2, 1.6)
    mouth: float = between(0.72, 0.95)
    foot: float = between(0.72, 0.9)
    thickness: float = between(0.145, 0.17)

    def build(self) -> Mesh:
        """Revolve a cup's wall on a solid stem and foot."""
        z, c, r = self.stem, self.cup, self.stem_radius
        line = [(0.0, z), (0.45, z + 0.06), (0.86, z + 0.33 * c), (0.93, z + 0.55 * c), (self.mouth, z + c)]
        cup = wall(smooth_curve(line), self.thickness)
        side = smooth_curve(
            [(self.foot, 0.15), (0.5 * self.foot, 0.24), (r, 0.5 * z), (r, 0.7 * z), (0.34, z)], 60
        )
        foot = np.concatenate([[(0.0, 0.0), (self.foot - 0.04, 0.0), (self.foot, 0.04)], side, [(0.0, z)]])
        return revolve(half_plane(cup, foot), 0.06)


@dataclass(frozen=True)
class Plate(Shape):
    """A dinner plate: a flat well, a raised rim, a foot ring."""

    size_range_m = (0.15, 0.32)
    well: float = between(0.58, 0.72)
    rise: float = between(0.16, 0.3)
    thickness: float = between(0.11, 0.13)

    def build(self) -> Mesh:
        """Revolve a wall with a foot ring."""
        w, z = self.well, self.rise
        line = [(0.0, 0.0), (0.5 * w, 0.0), (w - 0.05, 0.015), (w + 0.07, 0.6 * z), (1.0, z)]
        ring = rounded(0.7 * w - 0.06, 0.7 * w + 0.06, -0.14, 0.0, 0.03)
        return revolve(half_plane(wall(smooth_curve(line), self.thickness), ring), 0.045)


@dataclass(frozen=True)
class Gong(Shape):
    """A gong with a boss in the middle and a rim turned back."""

    size_range_m = (0.2, 0.7)
    boss: float = between(0.2, 0.3)
    boss_height: float = between(0.14, 0.24)
    rim: float = between(0.2, 0.34)
    thickness: float = between(0.113, 0.13)

    def build(self) -> Mesh:
        """Revolve a wall."""
        b, h = self.boss, self.boss_height
        dome = arc((0.0, 0.0), (b, h), 90, 20, 20)
        foot = smooth_curve([dome[-1], (b + 0.06, 0.03), (b + 0.16, 0.0)], 20)[1:]
        bend = arc((0.86, -0.14), 0.14, 90, 10, 14)
        line = np.concatenate([[(0.0, h)], dome[1:], foot, [(0.6, 0.0)], bend, [(1.0, -self.rim)]])
        return revolve(wall(line, self.thickness), 0.045)


@dataclass(frozen=True)
class Cymbal(Shape):
    """A cymbal: a shallow bow, a cup and a hole in the middle."""

    size_range_m = (0.2, 0.55)
    cup: float = between(0.24, 0.34)
    cup_height: float = between(0.1, 0.16)
    bow: float = between(0.1, 0.2)
    hole: float = between(0.06, 0.1)
    thickness: float = between(0.107, 0.12)

    def build(self) -> Mesh:
        """Revolve a wall that leaves a hole."""
        top = self.bow + self.cup_height
        line = [(self.hole + 0.06, top), (0.6 * self.cup + 0.08, top - 0.25 * self.cup_height)]
        line += [(self.cup + 0.06, self.bow + 0.01), (0.65, 0.6 * self.bow), (1.0, 0.0)]
        return revolve(wall(smooth_curve(line), self.thickness), 0.042)


@dataclass(frozen=True)
class Ring(Shape):
    """A bangle: a ring with a rounded section."""

    size_range_m = (0.05, 0.16)
    width: float = between(0.16, 0.6)
    thickness: float = between(0.15, 0.3)
    roundness: float = between(0.25, 0.5)

    def build(self) -> Mesh:
        """Revolve a rounded rectangle."""
        t, w = self.thickness, self.width
        section = rounded(1.0 - t, 1.0, -w / 2, w / 2, self.roundness * min(t, w) * 0.98)
        return revolve(section, 0.04)


@dataclass(frozen=True)
class Pipe(Shape):
    """A length of pipe, as in a tubular chime."""

    size_range_m = (0.12, 0.6)
    length: float = between(4.0, 6.0)
    thickness: float = between(0.33, 0.45)

    def build(self) -> Mesh:
        """Revolve a long rounded rectangle."""
        section = rounded(1.0 - self.thickness, 1.0, -self.length / 2, self.length / 2, 0.06)
        return revolve(section, 0.13)


@dataclass(frozen=True)
class Pawn(Shape):
    """A chess pawn."""

    size_range_m = (0.04, 0.12)
    height: float = between(2.3, 2.9)
    head: float = between(0.48, 0.6)
    neck: float = between(0.26, 0.36)
    collar: float = between(0.5, 0.62)

    def build(self) -> Mesh:
        """Revolve base, trunk, collar and head."""
        h, r = self.height, self.head
        body = smooth_curve(
            [(0.98, 0.3), (0.72, 0.55), (self.neck + 0.08, 0.5 * h), (self.neck, h - 1.9 * r)], 60
        )
        base = rounded(-0.2, 1.0, 0.0, 0.34, 0.12)
        trunk = np.concatenate([[(0.0, 0.2), (0.98, 0.2)], body, [(self.neck, h - r), (0.0, h - r)]])
        collar = rounded(-0.2, self.collar, h - 2.1 * r, h - 1.76 * r, 0.09)
        head = arc((0.0, h - r), r, -90, 90, 40)
        return revolve(half_plane(base, trunk, collar, head), 0.065)
