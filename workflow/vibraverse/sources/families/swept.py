"""Open-ended family of swept bodies: a section that changes along a random line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from vibraverse.geometry import Mesh
from vibraverse.geometry.profiles import frames, smooth_curve
from vibraverse.sources.families.primitives import direction
from vibraverse.sources.families.redraw import OpenShape
from vibraverse.sources.families.shape import between, one_of
from vibraverse.sources.families.solids import solid

#: Points of a section and of a path.
_AROUND, _ALONG = 48, 160
#: Least distance of a section's middle from its border, in longest sides of the path.
_LEAST = 0.03
#: The section reaches at most this share of the radius in which the path bends.
_MOST_CURVED = 0.75
#: Farther apart along the path than this many section radii, points keep a gap of the share below between them.
_FAR, _GAP = 3.6, 0.3

#: A path keeps this share of its bends in each of so many steps of relaxation.
_RELAXED, _RELAXATIONS = 0.85, 20


@dataclass(frozen=True)
class Sweep(OpenShape):
    """A section swept along a random line, open or closed."""

    size_range_m = (0.05, 0.4)
    path: str = one_of("open", "open", "closed")
    nodes: int = between(3, 8)
    radius: float = between(0.045, 0.16)
    flat: float = between(0.45, 1.0)
    turns: float = between(-1.0, 1.0)

    def body(self, random: np.random.Generator) -> Manifold | None:
        """Sweep rings about a path that bends little enough and keeps away from itself."""
        closed = self.path == "closed"
        line = _loop(random, self.nodes) if closed else _walk(random, self.nodes)
        share = np.arange(len(line)) / (len(line) - (0 if closed else 1))
        scale = self.radius * _swelling(random, share)
        outline = _outline(random) * [1.0, self.flat]
        scale = np.maximum(scale, _LEAST / np.linalg.norm(outline, axis=1).min())
        line = _relaxed(line, scale * np.linalg.norm(outline, axis=1).max(), closed)
        if line is None:
            return None
        turns = float(round(2 * self.turns)) / 2 if closed else self.turns
        spin = 2 * np.pi * turns * share
        if closed and turns % 1:  # half a turn takes the section to its mirror image through the centre
            outline = (outline - np.roll(outline, _AROUND // 2, axis=0)) / 2
        return solid(_swept(line, outline, scale, spin, closed, round_ends=random.random() < 0.5))


def _walk(random: np.random.Generator, nodes: int) -> np.ndarray:
    """Draw an open path (N, 3) by steps that turn by limited angles; a third of the paths is flat."""
    level = np.array([1.0, 1.0, 0.0 if random.random() < 0.35 else 1.0])
    heading, points = direction(random) * level, [np.zeros(3)]
    bend = random.uniform(0.2, 1.3)
    for _ in range(nodes):
        heading = heading / np.linalg.norm(heading) + bend * direction(random) * level
        points.append(points[-1] + random.uniform(0.5, 1.0) * heading / np.linalg.norm(heading))
    return smooth_curve(points, _ALONG)


def _loop(random: np.random.Generator, nodes: int) -> np.ndarray:
    """Draw a closed path (N, 3): a circle with waves in all directions."""
    t = 2 * np.pi * np.arange(_ALONG)[:, None] / _ALONG
    line = np.concatenate([np.cos(t), random.uniform(0.4, 1.0) * np.sin(t), 0 * t], axis=1)
    for k in range(2, 2 + nodes // 2):
        for wave in (np.cos(k * t), np.sin(k * t)):
            line = line + random.uniform(0.1, 0.5) / k * wave * direction(random)
    return line


def _relaxed(line: np.ndarray, widest: np.ndarray, closed: bool) -> np.ndarray | None:
    """Return a path of longest side 1 with room for sections as ``widest`` as that (N,), or None.

    A path that bends too much or meets itself is drawn towards a circle or a straight line, step by step.
    """
    if closed:
        t = 2 * np.pi * np.arange(len(line)) / len(line)
        rest = np.stack([np.cos(t), np.sin(t), 0 * t], axis=1)
    else:
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        rest = line[0] + lengths[:, None] * (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
    for step in range(_RELAXATIONS):
        path = rest + _RELAXED**step * (line - rest)
        path = path / np.ptp(path, axis=0).max()
        if not _bends_too_much(path, widest, closed) and not _meets_itself(path, widest, closed):
            return path
    return None


def _swelling(random: np.random.Generator, share: np.ndarray) -> np.ndarray:
    """Draw how wide the section is along the path (N,), periodic, the widest about 1."""
    depth, waves, phase = random.uniform(0.0, 0.3), int(random.integers(1, 4)), random.uniform(0, 2 * np.pi)
    return 1.0 - depth + depth * np.cos(2 * np.pi * waves * share + phase)


def _outline(random: np.random.Generator) -> np.ndarray:
    """Draw a section (48, 2) that every ray from the centre meets once: round, or cornered to some degree."""
    theta = 2 * np.pi * np.arange(_AROUND) / _AROUND
    corners = int(random.integers(2, 7))
    radius = 1.0 + random.uniform(0.0, 0.35) / max(corners - 1, 2) * np.cos(corners * theta)
    if random.random() < 0.4:  # between a circle and a square
        power = random.uniform(2.0, 6.0)
        radius = (np.abs(np.cos(theta)) ** power + np.abs(np.sin(theta)) ** power) ** (-1 / power)
    return np.stack([np.cos(theta), np.sin(theta)], axis=1) * radius[:, None]


def _bends_too_much(line: np.ndarray, widest: np.ndarray, closed: bool) -> bool:
    ring = np.concatenate([line[-3:], line, line[:3]]) if closed else line
    first = np.gradient(ring, axis=0)
    second = np.gradient(first, axis=0)
    bend = np.linalg.norm(np.cross(first, second), axis=1) / np.linalg.norm(first, axis=1) ** 3
    bend = bend[3:-3] if closed else bend
    return bool((bend * widest).max() > _MOST_CURVED)


def _meets_itself(line: np.ndarray, widest: np.ndarray, closed: bool) -> bool:
    steps = np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    along = np.abs(at[:-1, None] - at[None, :-1])
    along = np.minimum(along, at[-1] - along) if closed else along
    apart = np.linalg.norm(line[:, None] - line[None, :], axis=2)
    least = widest[:, None] + widest[None, :] + _GAP * widest.max()
    return bool(((along > _FAR * widest.max()) & (apart < least)).any())


def _swept(line, outline, scale, spin, closed: bool, round_ends: bool) -> Mesh:
    """Return the surface of rings (48 points each) along a path (N, 3), closed at its ends by a point each."""
    axes = frames(line, closed)
    rings = [_ring(line[k], axes[k], outline * scale[k], spin[k]) for k in range(len(line))]
    if closed:
        return _stitched(rings, closed=True)
    ends = []
    for k, side in ((0, -1.0), (-1, 1.0)):
        turns = np.linspace(0, np.pi / 2, 7)[1:-1] if round_ends else []
        depth = scale[k] * np.linalg.norm(outline, axis=1).min()
        out = side * depth * axes[k][2]
        caps = [
            _ring(line[k] + np.sin(t) * out, axes[k], np.cos(t) * scale[k] * outline, spin[k]) for t in turns
        ]
        tip = line[k] + (out if round_ends else 0.0)
        ends.append((caps, tip))
    (first, low), (last, high) = ends
    return _stitched([*first[::-1], *rings, *last], closed=False, tips=(low, high))


def _ring(centre, axes, outline, spin: float) -> np.ndarray:
    c, s = np.cos(spin), np.sin(spin)
    return centre + outline @ np.array([[c, s], [-s, c]]) @ axes[:2]


def _stitched(rings: list[np.ndarray], closed: bool, tips=()) -> Mesh:
    """Return the surface of rings of equally many points; a closed one joins the last to the first.

    The last ring meets the first at the point nearest to the first ring's first one.
    """
    n, m = len(rings), len(rings[0])
    here, ahead = np.arange(m), (np.arange(m) + 1) % m
    faces = []
    for k in range(n if closed else n - 1):
        a, b, shift = k * m, (k + 1) % n * m, 0
        if k == n - 1:
            shift = int(np.argmin(np.linalg.norm(rings[0] - rings[-1][0], axis=1)))
        up, up_ahead = b + (here + shift) % m, b + (ahead + shift) % m
        faces += [
            np.stack([a + here, a + ahead, up_ahead], axis=1),
            np.stack([a + here, up_ahead, up], axis=1),
        ]
    if not closed:
        low, high, last = n * m, n * m + 1, (n - 1) * m
        faces.append(np.stack([np.full(m, low), ahead, here], axis=1))
        faces.append(np.stack([np.full(m, high), last + here, last + ahead], axis=1))
    return np.concatenate([*rings, np.reshape(tips, (-1, 3))]), np.concatenate(faces)
