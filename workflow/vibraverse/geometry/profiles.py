"""Surfaces of revolution, extrusions and tubes, made of near-equilateral triangles.

Each builder returns ``(vertices, faces)`` of a closed surface that is oriented outwards and manifold by
construction. Outlines are arrays of points (N, 2), counter-clockwise, without repeating the first point.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from vibraverse.geometry import Mesh
from vibraverse.geometry.planar import fill, unite

_CORNER_RAD = np.radians(25.0)
#: Corners closer than this share of the spacing are merged.
_MIN_CORNER_DISTANCE = 0.25


def smooth_curve(points, n: int = 200) -> np.ndarray:
    """Return ``n`` points of the natural-parameter cubic spline through ``points`` (K, D)."""
    from scipy.interpolate import CubicSpline

    points = np.asarray(points, dtype=np.float64)
    steps = np.sqrt(np.linalg.norm(np.diff(points, axis=0), axis=1))  # centripetal: no loops
    t = np.concatenate([[0.0], np.cumsum(steps)])
    return CubicSpline(t, points, axis=0)(np.linspace(0.0, t[-1], n))


def arc(centre, radius, start_deg: float, end_deg: float, n: int = 32) -> np.ndarray:
    """Return ``n`` points of an arc; ``radius`` may be a pair for an ellipse."""
    angles = np.radians(np.linspace(start_deg, end_deg, n))
    return np.asarray(centre) + np.asarray(radius) * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def circle(centre, radius: float, n: int = 48) -> np.ndarray:
    """Return the outline of a circle."""
    return arc(centre, radius, 0.0, 360.0, n + 1)[:-1]


def polygon(sides: int, radius: float) -> np.ndarray:
    """Return the outline of a regular polygon about the origin; ``radius`` is that of its incircle."""
    return circle((0.0, 0.0), radius / np.cos(np.pi / sides), sides)


def turned(outline: np.ndarray, angle_deg: float) -> np.ndarray:
    """Return an outline rotated about the origin."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return outline @ np.array([[c, s], [-s, c]])


def rounded(left: float, right: float, low: float, high: float, radius: float) -> np.ndarray:
    """Return the outline of a rectangle with rounded corners."""
    corners = [
        (right, low, 1, 1, -90),
        (right, high, 1, -1, 0),
        (left, high, -1, -1, 90),
        (left, low, -1, 1, 180),
    ]
    arcs = [
        arc((x - inward_x * radius, y + inward_y * radius), radius, start, start + 90, 7)
        for x, y, inward_x, inward_y, start in corners
    ]
    return np.concatenate(arcs)


def wall(midline, thickness) -> np.ndarray:
    """Return the closed outline around an open ``midline`` (N, 2).

    ``thickness`` is a number or one value per point. The ends are rounded. If the midline begins on the axis (first
    coordinate 0), the outline is cut there, so that revolving closes it.
    """
    midline = np.asarray(midline, dtype=np.float64)
    half = np.broadcast_to(np.asarray(thickness, dtype=np.float64) / 2, len(midline))[:, None]
    along = np.gradient(midline, axis=0)
    if midline[0, 0] == 0:
        along[0] = (1.0, 0.0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.stack([along[:, 1], -along[:, 0]], axis=1)  # to the right, seen along the midline
    right, left = midline + half * across, midline - half * across
    angle = np.degrees(np.arctan2(across[-1, 1], across[-1, 0]))
    cap = arc(midline[-1], half[-1], angle, angle + 180.0, 16)[1:-1]
    outline = [right, cap, left[::-1]]
    if midline[0, 0] != 0:
        angle = np.degrees(np.arctan2(-across[0, 1], -across[0, 0]))
        outline.append(arc(midline[0], half[0], angle, angle + 180.0, 16)[1:-1])
    return unite(np.concatenate(outline))[0]  # the union removes the inner loop of a tight bend


def resample(outline: np.ndarray, spacing: float) -> np.ndarray:
    """Return a closed outline resampled to about ``spacing``, keeping corners of more than 25 degrees."""
    outline = _without_repeats(outline)
    back = outline - np.roll(outline, 1, axis=0)
    ahead = np.roll(outline, -1, axis=0) - outline
    turn = np.arctan2(back[:, 0] * ahead[:, 1] - back[:, 1] * ahead[:, 0], (back * ahead).sum(axis=1))
    corners = np.flatnonzero(np.abs(turn) > _CORNER_RAD)
    if len(corners) == 0:
        corners = np.array([0])
    outline = np.roll(outline, -corners[0], axis=0)
    ends = [*(corners - corners[0]), len(outline)]
    ring = np.concatenate([outline, outline[:1]])
    pieces = [_evenly(ring[a : b + 1], spacing, 3 if len(corners) == 1 else 1) for a, b in pairwise(ends)]
    points = np.concatenate(pieces)
    gaps = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    return points[gaps > _MIN_CORNER_DISTANCE * spacing]


def _without_repeats(outline: np.ndarray) -> np.ndarray:
    outline = np.asarray(outline, dtype=np.float64)
    scale = np.ptp(outline, axis=0).max()
    keep = np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1) > 1e-9 * scale
    return outline[keep]


def _evenly(line: np.ndarray, spacing: float, least: int) -> np.ndarray:
    """Return evenly spaced points of an open line, except the last one."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    n = max(least, round(lengths[-1] / spacing))
    at = np.linspace(0.0, lengths[-1], n + 1)[:-1]
    return np.stack([np.interp(at, lengths, line[:, k]) for k in range(line.shape[1])], axis=1)


def revolve(outline: np.ndarray, spacing: float) -> Mesh:
    """Revolve a closed outline of (r, z) points, r >= 0, about the z axis.

    The outline may touch the axis in one edge, which is left out. The number of points of a ring follows from its
    length, so triangles near the axis do not degenerate.
    """
    points = resample(outline, spacing)
    on_axis = points[:, 0] <= 1e-9 * np.ptp(points, axis=0).max()
    if on_axis.any():
        first = np.flatnonzero(on_axis & ~np.roll(on_axis, -1))[0]
        points = np.roll(points, -first, axis=0)
        on_axis = np.roll(on_axis, -first)
        last = np.flatnonzero(on_axis[1:])[0] + 1
        points = points[: last + 1]
    rings = [
        1 if flat else max(20 if r > spacing else 12, 2 * round(np.pi * r / spacing))
        for r, flat in zip(points[:, 0], on_axis[: len(points)], strict=True)
    ]
    starts = np.concatenate([[0], np.cumsum(rings)])
    vertices = np.concatenate(
        [_ring(r if n > 1 else 0.0, z, n) for (r, z), n in zip(points, rings, strict=True)]
    )
    pairs = [(k, k + 1) for k in range(len(points) - 1)]
    if not on_axis.any():
        pairs.append((len(points) - 1, 0))
    faces = [_stitch(starts[a], rings[a], starts[b], rings[b]) for a, b in pairs]
    return vertices, np.concatenate(faces)


def _ring(r: float, z: float, n: int) -> np.ndarray:
    angles = 2 * np.pi * np.arange(n) / n
    return np.stack([r * np.cos(angles), r * np.sin(angles), np.full(n, z)], axis=1)


def _stitch(a: int, n: int, b: int, m: int) -> np.ndarray:
    """Triangles between ring ``a`` of ``n`` points and the next ring ``b`` of ``m``, both evenly spaced."""
    triangles = []
    i = j = 0
    while i < (n if n > 1 else 0) or j < (m if m > 1 else 0):
        if m == 1 or (n > 1 and i < n and (j >= m or (i + 1) * m <= (j + 1) * n)):
            triangles.append((a + i % n, a + (i + 1) % n, b + j % m))
            i += 1
        else:
            triangles.append((a + i % n, b + (j + 1) % m, b + j % m))
            j += 1
    return np.array(triangles, dtype=np.int64)


def extrude(outlines: list[np.ndarray], height: float, spacing: float) -> Mesh:
    """Extrude a flat region along z, from -height/2 to height/2.

    ``outlines`` is the counter-clockwise outer outline and any clockwise holes; all are resampled.
    """
    rings = [resample(outline, spacing) for outline in outlines]
    points, triangles = fill(rings, spacing)
    layers = max(1, round(height / spacing))
    border = sum(len(ring) for ring in rings)
    levels = np.linspace(-height / 2, height / 2, layers + 1)
    sheet = [np.column_stack([points, np.full(len(points), z)]) for z in (levels[0], levels[-1])]
    middle = [np.column_stack([points[:border], np.full(border, z)]) for z in levels[1:-1]]
    vertices = np.concatenate([*sheet, *middle])
    base = [0, *(2 * len(points) + border * np.arange(layers - 1)), len(points)]
    faces = [triangles[:, ::-1], triangles + len(points)]
    following, start = np.arange(border), 0
    for ring in rings:
        following[start : start + len(ring)] = start + (np.arange(len(ring)) + 1) % len(ring)
        start += len(ring)
    here = np.arange(border)
    for low, high in pairwise(base):
        faces.append(np.stack([low + here, low + following, high + following], axis=1))
        faces.append(np.stack([low + here, high + following, high + here], axis=1))
    return vertices, np.concatenate(faces)


def tube(path, radius, spacing: float, closed: bool = False) -> Mesh:
    """Sweep a circle along a 3D ``path`` (N, 3), with round ends; ``radius`` is a number or one per point."""
    path = np.asarray(path, dtype=np.float64)
    radius = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(path))
    line = np.column_stack([path, radius])
    if closed:
        line = np.concatenate([line, line[:1]])
        line = _evenly(line, spacing, 8)
    else:
        line = np.concatenate([_evenly(line, spacing, 2), line[-1:]])
    centres, radii = line[:, :3], line[:, 3]
    axes = frames(centres, closed)
    n = max(20, 2 * round(np.pi * radii.max() / spacing))
    rings = [(centre, r, 0.0, k) for k, (centre, r) in enumerate(zip(centres, radii, strict=True))]
    if not closed:
        steps = max(2, round(np.pi / 2 * radii.max() / spacing))
        turns = np.arange(1, steps) * (np.pi / 2) / steps
        first = [(centres[0], radii[0] * np.cos(t), -radii[0] * np.sin(t), 0) for t in turns[::-1]]
        last = [(centres[-1], radii[-1] * np.cos(t), radii[-1] * np.sin(t), len(line) - 1) for t in turns]
        rings = [*first, *rings, *last]
    angles = 2 * np.pi * np.arange(n) / n
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = [centre + shift * axes[k][2] + r * circle @ axes[k][:2] for centre, r, shift, k in rings]
    faces = [_stitch(n * k, n, n * (k + 1), n) for k in range(len(rings) - 1)]
    if closed:
        faces.append(_stitch(n * (len(rings) - 1), n, 0, n))
        return np.concatenate(vertices), np.concatenate(faces)
    tips = [centres[0] - radii[0] * axes[0][2], centres[-1] + radii[-1] * axes[-1][2]]
    top = n * len(rings)
    faces.insert(0, _stitch(top, 1, 0, n))
    faces.append(_stitch(n * (len(rings) - 1), n, top + 1, 1))
    return np.concatenate([*vertices, np.array(tips)]), np.concatenate(faces)


def frames(centres: np.ndarray, closed: bool) -> np.ndarray:
    """Return frames (N, 3, 3) along a path, transported without twist; the third axis is its direction.

    On a closed path an angle remains between the last frame and the first; it is spread over all frames.
    """
    ring = np.concatenate([centres[-1:], centres, centres[:1]])
    along = np.gradient(ring, axis=0)[1:-1] if closed else np.gradient(centres, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    sides = np.empty_like(along)
    side = np.eye(3)[np.argmin(np.abs(along[0]))]
    for k, direction in enumerate(along):
        side = _perpendicular(side, direction)
        sides[k] = side
    if closed:
        back = _perpendicular(side, along[0])
        angle = np.arctan2(np.cross(back, sides[0]) @ along[0], back @ sides[0])
        turn = (np.arange(len(along)) / len(along) * angle)[:, None]
        sides = np.cos(turn) * sides + np.sin(turn) * np.cross(along, sides)
    return np.stack([sides, np.cross(along, sides), along], axis=1)


def _perpendicular(side: np.ndarray, direction: np.ndarray) -> np.ndarray:
    side = side - (side @ direction) * direction
    return side / np.linalg.norm(side)
