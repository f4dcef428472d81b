"""Open-ended families of revolution: bodies from the lathe, with bores, pressed flat or lobed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from vibraverse.geometry.planar import half_plane, soften, subtract
from vibraverse.geometry.profiles import revolve, smooth_curve
from vibraverse.sources.families import warps
from vibraverse.sources.families.redraw import OpenShape
from vibraverse.sources.families.shape import between, one_of
from vibraverse.sources.families.solids import solid

#: Rings along a profile of length 1, before the surface is made even.
SPACING = 0.045
#: Least wall of a bored body, in longest sides.
_BORED_WALL = 0.07
#: Least mean distance of the nodes of a profile along the axis, in longest sides.
_NODE_SPACING = 0.09
#: Radius of the corners of a profile, in longest sides.
_ROUNDING = 0.012


@dataclass(frozen=True)
class Lathe(OpenShape):
    """A turned body with a random profile."""

    size_range_m = (0.05, 0.4)
    nodes: int = between(3, 9)
    slender: float = between(-1.6, 1.6)
    edges: float = between(0.0, 1.0)
    bore: str = one_of("none", "none", "through", "blind")

    def body(self, random: np.random.Generator) -> Manifold | None:
        """Revolve the region between the axis and the profile, minus the bore, and perhaps warp it."""
        height = float(np.exp2(self.slender))
        profile = self._profile(random, height)
        # Both halves, so that rounding leaves the axis alone.
        whole = [np.concatenate([profile, profile[::-1] * [-1.0, 1.0]])]
        if self.bore != "none":
            bore = self._bore(random, profile, height)
            if bore is None:
                return None
            whole = subtract(whole[0], bore)
        right = max(whole, key=lambda ring: ring[:, 0].mean())
        radius = _ROUNDING * max(2.0, height)
        outline = half_plane(soften([right], radius, radius)[0])
        return solid(off_round(random, revolve(outline, SPACING * max(2.0, height))))

    def _profile(self, random: np.random.Generator, height: float) -> np.ndarray:
        """Draw radii, the largest 1, at random heights, and join them by curves, by lines, or by steps.

        There are ``nodes`` of them, or fewer if the body is too flat for so many.
        """
        from scipy.interpolate import PchipInterpolator

        nodes = min(self.nodes, 2 + int(height / (_NODE_SPACING * max(2.0, height))))
        gaps = random.uniform(0.4, 1.6, size=nodes - 1)
        z = height * np.concatenate([[0.0], np.cumsum(gaps) / gaps.sum()])
        r = random.uniform(0.25, 1.0, size=nodes)
        r /= r.max()
        smooth = PchipInterpolator(z, r)
        line: list[tuple[float, float]] = [(r[0], z[0])]
        for k in range(nodes - 1):
            kind = random.random()
            if kind > self.edges:
                line += [(float(smooth(at)), at) for at in np.linspace(z[k], z[k + 1], 16)[1:]]
            elif kind > 0.5 * self.edges:
                line.append((r[k + 1], z[k + 1]))
            else:
                step = z[k] + random.uniform(0.25, 0.75) * (z[k + 1] - z[k])
                line += [(r[k], step), (r[k + 1], step + 1e-3 * height), (r[k + 1], z[k + 1])]
        return np.array(line)

    def _bore(self, random: np.random.Generator, profile, height: float) -> np.ndarray | None:
        """Return the outline of a bore that leaves a wall everywhere, or None if the body is too slender."""
        wall = _BORED_WALL * max(2.0, height)
        bottom = -1.0 if self.bore == "through" else random.uniform(wall, 0.7 * height)
        room = profile[profile[:, 1] >= bottom - wall, 0].min() - wall
        if room < 0.5 * wall or bottom > height - wall:
            return None
        radius = random.uniform(0.5 * wall, room)
        inner, top = random.uniform(0.8, 1.0) * radius, height + 1.0
        right = np.array([(inner, bottom), (radius, height), (radius, top)])
        return np.concatenate([right, right[::-1] * [-1.0, 1.0]])


def off_round(random: np.random.Generator, surface):
    """Return a surface of revolution as it is, pressed to an ellipse, or with lobes."""
    vertices, faces = surface
    kind = random.random()
    if kind < 0.3:
        vertices = vertices * [1.0, random.uniform(0.45, 0.9), 1.0]
    elif kind < 0.5:
        vertices = warps.lobes(vertices, int(random.integers(2, 7)), random.uniform(0.04, 0.18))
    return vertices, faces


def midline(random: np.random.Generator, nodes: int, start: float) -> np.ndarray:
    """Draw a smooth line (N, 2) of (r, z) that begins at radius ``start`` and goes outwards, then mostly up.

    It begins on the axis at right angles where ``start`` is 0. Its steps turn by limited random angles.
    """
    heading = random.uniform(-0.2, 0.5) if start == 0 else random.uniform(-0.3, np.pi / 2)
    points = [np.array([start, 0.0])]
    if start == 0:
        points.append(np.array([0.25, 0.0]))
    for _ in range(nodes):
        length = random.uniform(0.25, 0.6)
        points.append(points[-1] + length * np.array([np.cos(heading), np.sin(heading)]))
        heading += random.uniform(-0.6, 0.9)
    return smooth_curve(points, 30 * len(points))
