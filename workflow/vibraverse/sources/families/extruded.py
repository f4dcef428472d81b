"""Shape families that are flat outlines with a thickness: bars, forks, gears, wrenches, plates to strike.

Outlines are drawn at about unit length and made of arcs and unions in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.geometry import Mesh
from vibraverse.geometry.planar import soften, subtract, unite
from vibraverse.geometry.profiles import arc, circle, extrude, polygon, rounded, turned, wall
from vibraverse.sources.families.shape import Shape, between, one_of


@dataclass(frozen=True)
class Bar(Shape):
    """A marimba bar: a bar thinned below by a smooth undercut."""

    size_range_m = (0.12, 0.5)
    width: float = between(0.12, 0.22)
    thickness: float = between(0.085, 0.12)
    undercut: float = between(0.2, 0.4)
    span: float = between(0.45, 0.62)

    def build(self) -> Mesh:
        """Extrude the side view across the width and lay the bar flat."""
        t, depth, half = self.thickness, self.undercut * self.thickness, self.span / 2
        x = np.linspace(-half, half, 60)
        arch = np.stack([x, depth * np.cos(np.pi * x / self.span) ** 0.7], axis=1)
        side = np.concatenate([[(-0.5, t), (-0.5, 0.0)], arch, [(0.5, 0.0), (0.5, t)]])
        vertices, faces = extrude([side], self.width, 0.02)
        return vertices @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]), faces


@dataclass(frozen=True)
class TuningFork(Shape):
    """A tuning fork: two tines, a round yoke and a stem."""

    size_range_m = (0.1, 0.2)
    tine: float = between(0.055, 0.075)
    gap: float = between(0.07, 0.12)
    stem: float = between(0.28, 0.4)
    thickness: float = between(0.06, 0.09)

    def build(self) -> Mesh:
        """Extrude a U with a stem that ends in a ball."""
        inner, outer = self.gap / 2, self.gap / 2 + self.tine
        yoke = arc((0.0, 0.0), outer, 180, 360, 40)
        slot = arc((0.0, 0.0), inner, 360, 180, 24)
        length = 1.0 - self.stem - outer
        fork = np.concatenate(
            [yoke, [(outer, length), (inner, length)], slot, [(-inner, length), (-outer, length)]]
        )
        half = 0.55 * self.tine
        stem = rounded(-half, half, -outer - self.stem, -inner - 0.3 * self.tine, 0.95 * half)
        outline = soften(unite(fork, stem), 0.4 * self.tine, 0.12 * self.tine)
        return extrude(outline, self.thickness, 0.016)


@dataclass(frozen=True)
class Gear(Shape):
    """A spur gear with a bore, and holes in its web."""

    size_range_m = (0.04, 0.2)
    teeth: int = between(10, 18)
    depth: float = between(0.14, 0.2)
    bore: float = between(0.16, 0.28)
    thickness: float = between(0.2, 0.45)
    holes: int = one_of(0, 4, 5, 6)

    def build(self) -> Mesh:
        """Extrude a wheel of trapezoid teeth."""
        pitch = 2 * np.pi / self.teeth
        root = 1.0 - self.depth
        angles, radii = [], []
        for k in range(self.teeth):
            for share, radius in ((-0.27, root), (-0.13, 1.0), (0.13, 1.0), (0.27, root)):
                angles.append((k + share) * pitch)
                radii.append(radius)
        wheel = np.stack([np.cos(angles), np.sin(angles)], axis=1) * np.array(radii)[:, None]
        width = root - self.bore
        rings = [circle((0.0, 0.0), self.bore)]
        for k in range(self.holes):
            angle = 2 * np.pi * k / self.holes
            middle = self.bore + 0.5 * width
            rings.append(circle((middle * np.cos(angle), middle * np.sin(angle)), 0.22 * width))
        return extrude(subtract(soften([wheel], 0.03, 0.02)[0], *rings), self.thickness, 0.05)


@dataclass(frozen=True)
class Wrench(Shape):
    """A wrench with an open jaw at one end and a ring at the other."""

    size_range_m = (0.1, 0.3)
    shaft: float = between(0.085, 0.11)
    head: float = between(0.13, 0.15)
    ring: float = between(0.11, 0.13)
    tilt_deg: float = between(0.0, 18.0)
    thickness: float = between(0.06, 0.09)

    def build(self) -> Mesh:
        """Extrude a shaft joined to a head with a slot and an eye with a hexagonal hole."""
        h, r = self.head, self.ring
        head, eye = circle((-0.5 + h, 0.0), h), circle((0.5 - r, 0.0), r)
        shaft = rounded(-0.5 + h, 0.5 - r, -self.shaft / 2, self.shaft / 2, 0.01)
        slot = turned(rounded(-3 * h, 0.25 * h, -0.4 * h, 0.4 * h, 0.2 * h), self.tilt_deg)
        hexagon = polygon(6, r - 0.065) + np.array([0.5 - r, 0.0])
        body = soften(unite(head, eye, shaft), 0.06, 0.005)
        return extrude(subtract(body[0], slot + np.array([-0.5 + h, 0.0]), hexagon), self.thickness, 0.018)


@dataclass(frozen=True)
class Chime(Shape):
    """A chime plate with two holes to hang it by."""

    size_range_m = (0.08, 0.35)
    width: float = between(0.28, 0.6)
    corner: float = between(0.1, 0.45)
    hole: float = between(0.03, 0.045)
    thickness: float = between(0.055, 0.075)

    def build(self) -> Mesh:
        """Extrude a rounded rectangle with holes at a free bar's nodes, 0.224 of its length from the ends."""
        w = self.width
        sheet = rounded(-0.5, 0.5, -w / 2, w / 2, self.corner * w)
        holes = [circle((side * (0.5 - 0.224), 0.0), self.hole, 24) for side in (-1, 1)]
        return extrude(subtract(sheet, *holes), self.thickness, 0.02)


@dataclass(frozen=True)
class Horseshoe(Shape):
    """A horseshoe with a row of nail holes on each branch."""

    size_range_m = (0.09, 0.15)
    width: float = between(0.17, 0.22)
    opening_deg: float = between(50.0, 75.0)
    taper: float = between(0.7, 0.9)
    thickness: float = between(0.07, 0.11)

    def build(self) -> Mesh:
        """Extrude a band along an open ellipse."""
        half = self.opening_deg / 2
        line = arc((0.0, 0.0), (0.4, 0.46), -90 + half, 270 - half, 120)
        share = np.abs(np.linspace(-1, 1, len(line)))
        band = wall(line, self.width * (1.0 - (1.0 - self.taper) * share))
        nails = [line[k] for k in (22, 42, 77, 97)]
        return extrude(subtract(band, *(circle(nail, 0.028, 16) for nail in nails)), self.thickness, 0.024)


@dataclass(frozen=True)
class Star(Shape):
    """A star to hang up, with rounded points and a hole below one."""

    size_range_m = (0.06, 0.25)
    points: int = between(5, 8)
    inner: float = between(0.45, 0.6)
    thickness: float = between(0.11, 0.2)

    def build(self) -> Mesh:
        """Extrude a rounded star."""
        n = 2 * self.points
        radii = np.where(np.arange(n) % 2 == 0, 1.0, self.inner)
        angles = np.pi / 2 + 2 * np.pi * np.arange(n) / n
        star = np.stack([np.cos(angles), np.sin(angles)], axis=1) * radii[:, None]
        return extrude(
            subtract(soften([star], 0.05, 0.08)[0], circle((0.0, 0.5), 0.07, 20)), self.thickness, 0.05
        )


@dataclass(frozen=True)
class Key(Shape):
    """An old key: a bow to hold, a shank, a bit with wards."""

    size_range_m = (0.06, 0.16)
    bow: float = between(0.15, 0.19)
    shank: float = between(0.07, 0.09)
    bit: float = between(0.14, 0.2)
    wards: int = between(1, 2)
    thickness: float = between(0.06, 0.08)

    def build(self) -> Mesh:
        """Extrude bow, shank and bit."""
        b, s = self.bow, self.shank / 2
        bow = arc((-0.5 + b, 0.0), (b, 1.15 * b), 0, 360, 49)[:-1]
        shank = rounded(-0.5 + b, 0.5, -s, s, 0.6 * s)
        collar = rounded(-0.5 + 2 * b - 0.01, -0.5 + 2 * b + 0.05, -1.7 * s, 1.7 * s, 0.015)
        bit = rounded(0.18, 0.45, -s - self.bit, 0.0, 0.008)
        eye = arc((-0.5 + b, 0.0), (b - 0.065, 1.15 * b - 0.065), 0, 360, 37)[:-1]
        width = 0.27 / (2 * self.wards + 1)
        wards = [
            rounded(x, x + width, -2 * s - self.bit, -s - 0.45 * self.bit, 0.006)
            for x in (0.18 + width * (2 * k + 1) for k in range(self.wards))
        ]
        return extrude(subtract(unite(bow, shank, collar, bit)[0], eye, *wards), self.thickness, 0.018)
