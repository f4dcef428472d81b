"""Shape families that join solids: cups with handles, lidded boxes, spoons, blobs, stools.

Parts are revolved, extruded or swept. The union of overlapping solids is again a closed manifold. A handle ends in the
middle of the wall that it meets, so that surfaces never coincide.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vibraverse.contract.seeds import rng
from vibraverse.geometry import Mesh
from vibraverse.geometry.planar import half_plane, soften
from vibraverse.geometry.profiles import arc, extrude, revolve, rounded, smooth_curve, tube, wall
from vibraverse.sources.families.shape import Shape, between, one_of
from vibraverse.sources.families.solids import evened, place, solid, union


@dataclass(frozen=True)
class Cup(Shape):
    """A cup with a handle."""

    size_range_m = (0.08, 0.14)
    height: float = between(1.5, 2.1)
    waist: float = between(0.8, 1.0)
    handle: float = between(0.5, 0.62)
    handle_radius: float = between(0.1, 0.13)
    thickness: float = between(0.15, 0.18)

    def build(self) -> Mesh:
        """Join a beaker and a bent tube whose ends lie in the middle of the beaker's wall."""
        h, w = self.height, self.waist
        corner = arc((w - 0.25, 0.25), 0.25, -90, -5, 10)
        side = smooth_curve([corner[-1], (0.5 * (w + 1.0), 0.55 * h), (1.0, h)], 30)[1:]
        line = np.concatenate([[(0.0, 0.0), (0.3, 0.0)], corner, side])
        core = np.concatenate([line, [(1.0, 1.2 * h), (0.0, 1.2 * h)]])
        low, high = np.interp([0.24 * h, 0.8 * h], side[:, 1], side[:, 0]) - 0.02
        reach = 1.0 + self.handle
        path = [(low, 0.22 * h), (0.75 * reach, 0.22 * h), (reach, 0.5 * h), (0.8 * reach, 0.8 * h)]
        handle = tube(_upright(smooth_curve([*path, (high, 0.82 * h)], 80)), self.handle_radius, 0.05)
        cup = revolve(wall(line, self.thickness), 0.06)
        return evened(union(solid(cup), solid(handle) - solid(revolve(core, 0.06))), 0.12)


@dataclass(frozen=True)
class Box(Shape):
    """A hollow box whose overhanging lid is joined to it, with a knob and a slot."""

    size_range_m = (0.08, 0.3)
    depth: float = between(0.6, 1.0)
    height: float = between(0.4, 0.7)
    thickness: float = between(0.06, 0.08)
    overhang: float = between(0.03, 0.05)
    knob: float = between(0.07, 0.1)

    def build(self) -> Mesh:
        """Join body, lid and knob, and subtract the inside and a slot in the front: one surface, no cavity."""
        x, y, z, t, over = 1.0, self.depth, self.height, self.thickness, 2 * self.overhang
        body = solid(extrude([_box_outline(x, y, 0.1)], z, 0.03))
        inside = solid(extrude([_box_outline(x - 2 * t, y - 2 * t, 0.06)], z - 2 * t, 0.03))
        lid = solid(extrude([_box_outline(x + over, y + over, 0.1 + over / 2)], 1.3 * t, 0.03))
        knob = solid(revolve(half_plane(arc((0.0, 0.0), self.knob, -90, 90, 24)), 0.03))
        slot = solid(extrude([rounded(-0.2, 0.2, -0.06, 0.06, 0.055)], 4 * t, 0.02))
        joined = union(body, place(lid, z=z / 2), place(knob, z=z / 2 + 0.65 * t + 0.8 * self.knob))
        return evened(joined - inside - place(slot, turn_x=90, y=-y / 2), 0.07)


@dataclass(frozen=True)
class Spoon(Shape):
    """A spoon with a round bowl and a flat handle."""

    size_range_m = (0.12, 0.3)
    bowl: float = between(0.13, 0.17)
    slender: float = between(0.75, 0.9)
    depth: float = between(0.3, 0.5)
    handle: float = between(0.07, 0.1)
    thickness: float = between(0.06, 0.07)

    def build(self) -> Mesh:
        """Join a bowl, stretched to an ellipse, and a handle that widens to its end."""
        b, t = self.bowl, self.thickness
        line = smooth_curve([(0.0, -self.depth * b), (0.6, -0.75 * self.depth * b), (1.0, 0.0)], 40)
        line[:, 0] *= b
        vertices, faces = revolve(wall(line, t), 0.02)
        bowl = solid((vertices * [1.0, self.slender, 1.0], faces))
        end, half = 1.0 - 2 * b, self.handle / 2
        outline = [(0.0, -0.03), (0.25, -0.03), (0.8 * end, -half), (end, -0.6 * half)]
        lower = smooth_curve(outline, 40)
        flat = extrude([np.concatenate([lower, lower[::-1] * [1, -1]])], t, 0.02)
        handle = place(solid(flat), x=b - 0.02)
        lift = smooth_curve([(b - 0.2, 0.0), (b, 0.0), (b + 0.3 * end, 0.06), (b + end, 0.02)], 100)
        handle = handle.warp_batch(
            lambda p: np.column_stack([p[:, :2], p[:, 2] + np.interp(p[:, 0], lift[:, 0], lift[:, 1])])
        )
        return evened(union(bowl, handle), 0.024)


@dataclass(frozen=True)
class Blob(Shape):
    """A smooth union of balls: a pebble with bumps."""

    size_range_m = (0.05, 0.2)
    balls: int = between(4, 7)
    blend: float = between(0.1, 0.25)
    arrangement: int = between(0, 999_999)

    def build(self) -> Mesh:
        """Take the level set of the smooth minimum of distances: ``-k log sum exp(-d_i / k) = 0``."""
        from manifold3d import Manifold

        random = rng(str(self.arrangement), "balls")
        balls = [(0.0, 0.0, 0.0, 0.5)]
        for _ in range(self.balls - 1):
            parent = balls[random.integers(len(balls))]
            direction = random.normal(size=3)
            direction /= np.linalg.norm(direction)
            radius = random.uniform(0.25, 0.45)
            centre = np.array(parent[:3]) + 0.8 * (parent[3] + radius) * direction
            balls.append((*(round(float(c), 4) for c in centre), round(float(radius), 4)))
        k = self.blend

        def inside(x: float, y: float, z: float) -> float:
            total = 0.0
            for cx, cy, cz, r in balls:
                total += math.exp((r - math.dist((x, y, z), (cx, cy, cz))) / k)
            return k * math.log(total)

        centres, radii = np.array(balls)[:, :3], np.array(balls)[:, 3:]
        low, high = (centres - radii).min(axis=0) - 3 * k, (centres + radii).max(axis=0) + 3 * k
        step = float((high - low).max()) / 34
        return evened(Manifold.level_set(inside, [*low, *high], step), 1.2 * step)


@dataclass(frozen=True)
class Pan(Shape):
    """A frying pan."""

    size_range_m = (0.25, 0.5)
    depth: float = between(0.32, 0.5)
    handle: float = between(1.2, 1.6)
    handle_width: float = between(0.24, 0.3)
    thickness: float = between(0.185, 0.205)

    def build(self) -> Mesh:
        """Join a shallow pan and a flat handle with an eye."""
        t, d = self.thickness, self.depth
        bend = arc((0.7, 0.18), 0.18, -90, -20, 10)
        pan = solid(revolve(wall(np.concatenate([[(0.0, 0.0), (0.3, 0.0)], bend, [(1.0, d)]]), t), 0.07))
        w = self.handle_width / 2
        grip = rounded(0.0, self.handle + 0.12, -w, w, 0.9 * w)
        grip = soften([grip], 0.0, 0.05)[0]
        handle = place(solid(extrude([grip], 0.2, 0.06)), turn_y=-12, x=0.9, z=0.75 * d)
        return evened(union(pan, handle - place(solid(revolve(_plug(0.9, d), 0.2)), z=t / 2)), 0.085)


def _plug(radius: float, height: float) -> np.ndarray:
    return np.array([(0.0, 0.0), (radius, 0.0), (radius, 3 * height), (0.0, 3 * height)])


@dataclass(frozen=True)
class Hammer(Shape):
    """A hammer: a round face, a wedge and a handle."""

    size_range_m = (0.15, 0.35)
    head: float = between(0.34, 0.44)
    face: float = between(0.07, 0.09)
    handle: float = between(0.04, 0.05)

    def build(self) -> Mesh:
        """Join head, neck and handle."""
        f, half = self.face, self.head / 2
        profile = [
            (0.0, -half),
            (0.9 * f, -half),
            (f, -half + 0.02),
            (f, -half + 0.09),
            (0.72 * f, -half + 0.13),
        ]
        profile += [(0.72 * f, 0.05), (0.8 * f, 0.08), (0.0, 0.08)]
        face = place(solid(revolve(np.array(profile), 0.022)), turn_y=90, z=1.0)
        wedge = np.array([(0.04, -0.75 * f), (half, -0.04), (half, 0.04), (0.04, 0.75 * f)])
        wedge = place(solid(extrude([wedge], 1.5 * f, 0.022)), turn_x=90, z=1.0)
        path = [(0.0, 0.0, z) for z in np.linspace(0.05, 1.03, 30)]
        swell = self.handle * (1.0 - 0.2 * np.sin(np.linspace(0.0, np.pi, 30)))
        return evened(union(face, wedge, solid(tube(path, swell, 0.022))), 0.028)


@dataclass(frozen=True)
class Stool(Shape):
    """A stool: a round seat on three or four legs, with a ring that joins them."""

    size_range_m = (0.2, 0.5)
    legs: int = one_of(3, 4)
    spread: float = between(0.1, 0.3)
    height: float = between(1.5, 2.0)
    leg: float = between(0.09, 0.11)
    seat: float = between(0.16, 0.22)

    def build(self) -> Mesh:
        """Join seat, legs and ring."""
        h, s = self.height, self.seat
        seat = place(solid(revolve(half_plane(rounded(-0.2, 1.0, 0.0, s, 0.07)), 0.07)), z=h - s)
        parts = [seat]
        for k in range(self.legs):
            angle = 2 * np.pi * k / self.legs
            out = np.array([np.cos(angle), np.sin(angle)])
            top, foot = 0.68 * out, (0.72 + self.spread) * out
            parts.append(solid(tube([(*foot, self.leg), (*top, h - 0.5 * s)], self.leg, 0.06)))
        at = 0.68 + (0.04 + self.spread) * 0.62
        angles = np.linspace(0, 2 * np.pi, 97)[:-1]
        ring = np.stack([at * np.cos(angles), at * np.sin(angles), np.full(96, 0.38 * h)], axis=1)
        parts.append(solid(tube(ring, 0.9 * self.leg, 0.06, closed=True)))
        return evened(union(*parts), 0.11)


@dataclass(frozen=True)
class Teapot(Shape):
    """A teapot with spout, handle and lid, the lid joined."""

    size_range_m = (0.14, 0.28)
    height: float = between(1.25, 1.6)
    spout: float = between(0.75, 0.95)
    handle: float = between(0.65, 0.8)
    thickness: float = between(0.2, 0.22)

    def build(self) -> Mesh:
        """Join pot, spout, handle and knob, and subtract the inside, which opens through the spout."""
        h, t = self.height, self.thickness
        outline = smooth_curve([(0.62, 0.0), (0.98, 0.4 * h), (0.8, 0.78 * h), (0.45, h)], 60)
        pot = np.concatenate([[(0.0, 0.0)], outline, [(0.0, h + 0.06)]])
        knob = np.array([0.0, h + 0.18]) + arc((0.0, 0.0), 0.17, -90, 90, 20)
        rim = rounded(-0.3, 0.56, h - 0.16, h + 0.03, 0.07)
        body = solid(revolve(half_plane(pot, knob, rim), 0.06))
        way = smooth_curve(
            [(0.6, 0.36 * h), (1.2, 0.45 * h), (1.4, 0.75 * h), (0.95 + self.spout, 1.0 * h)], 60
        )
        way = _upright(way)
        spout = solid(tube(way, np.linspace(0.32, 0.24, 60), 0.06))
        channel = np.concatenate([way, way[-1:] + (way[-1] - way[-4]) * [[2.0], [5.0]]])
        reach = 0.95 + self.handle
        bow = smooth_curve([(-0.75, 0.2 * h), (-reach, 0.3 * h), (-reach, 0.8 * h), (-0.68, 0.82 * h)], 60)
        handle = solid(tube(_upright(bow), 0.115, 0.06))
        inner = smooth_curve([(0.62 - t, t), (0.98 - t, 0.4 * h), (0.8 - t, 0.72 * h), (0.2, h - t)], 40)
        inside = solid(revolve(np.concatenate([[(0.0, t)], inner, [(0.0, h - t)]]), 0.07))
        return evened(union(body, spout, handle) - inside - solid(tube(channel, 0.075, 0.05)), 0.1)


@dataclass(frozen=True)
class Triangle(Shape):
    """A triangle to strike: a rod bent to an open triangle."""

    size_range_m = (0.1, 0.25)
    rod: float = between(0.028, 0.036)
    opening: float = between(0.1, 0.2)
    bend: float = between(0.08, 0.12)

    def build(self) -> Mesh:
        """Sweep a circle along a triangle with round corners, open at one."""
        corners = np.array([(-0.5, 0.0), (0.5, 0.0), (0.0, 0.866)])
        path = [corners[0] + (corners[1] - corners[0]) * self.opening]
        for k in (1, 2):
            before, at, after = corners[k - 1], corners[k], corners[(k + 1) % 3]
            a, b = at + (before - at) * self.bend * 2, at + (after - at) * self.bend * 2
            s = np.linspace(0, 1, 16)[:, None]
            path.extend((1 - s) ** 2 * a + 2 * s * (1 - s) * at + s**2 * b)
        path.append(corners[0])
        path = np.array(path)
        return tube(_upright(path), self.rod, 0.012)


@dataclass(frozen=True)
class Knot(Shape):
    """A rope of metal tied to a trefoil knot."""

    size_range_m = (0.06, 0.2)
    radius: float = between(0.28, 0.38)
    lift: float = between(0.85, 1.1)

    def build(self) -> Mesh:
        """Sweep a circle along the closed curve (sin t + 2 sin 2t, cos t - 2 cos 2t, -sin 3t)."""
        t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
        curve = np.stack(
            [np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -self.lift * np.sin(3 * t)]
        )
        return tube(curve.T, self.radius, 0.16, closed=True)


def _upright(curve: np.ndarray) -> np.ndarray:
    """Return a plane curve (N, 2) as a curve in space with y = 0."""
    return np.column_stack([curve[:, 0], np.zeros(len(curve)), curve[:, 1]])


def _box_outline(width: float, depth: float, radius: float) -> np.ndarray:
    return rounded(-width / 2, width / 2, -depth / 2, depth / 2, radius)
