"""Flat regions filled with near-equilateral triangles."""

from __future__ import annotations

import numpy as np


def fill(rings: list[np.ndarray], spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 2) and counter-clockwise triangles (F, 3) of the region inside the outlines.

    The first points are those of ``rings`` in order, each already sampled at about ``spacing``; the outer
    outline is counter-clockwise, holes are clockwise. Points of a triangular lattice fill the inside and
    Delaunay's triangulation joins all. Where it does not keep an outline, ear cutting takes its place.
    """
    from scipy.spatial import Delaunay

    border = np.concatenate(rings)
    lattice = _lattice(border.min(axis=0), border.max(axis=0), spacing)
    lattice = lattice[inside(lattice, rings)]
    lattice = lattice[distance(lattice, border) > 0.7 * spacing] if len(lattice) else lattice
    points = np.concatenate([border, lattice])
    triangles = Delaunay(points).simplices.astype(np.int64)
    triangles = _counter_clockwise(points, triangles)
    triangles = triangles[inside(points[triangles].mean(axis=1), rings)]
    if not _bounded_by(triangles, rings):
        import manifold3d

        triangles = np.asarray(manifold3d.triangulate(rings), dtype=np.int64)
        return border, triangles
    # Qhull's order may change between versions; the set of triangles does not.
    triangles = np.array([np.roll(t, -np.argmin(t)) for t in triangles])
    return points, triangles[np.lexsort(triangles.T[::-1])]


def _lattice(low: np.ndarray, high: np.ndarray, spacing: float) -> np.ndarray:
    """Return the points of a triangular lattice in a rectangle, symmetric about its centre."""
    centre, half = (low + high) / 2, (high - low) / 2
    rows = np.arange(-np.floor(half[1] / (spacing * 0.75**0.5)), half[1] / (spacing * 0.75**0.5) + 1)
    columns = np.arange(-np.floor(half[0] / spacing) - 1, half[0] / spacing + 2)
    x = columns[None, :] + 0.5 * (np.abs(rows[:, None]) % 2)
    y = np.broadcast_to(rows[:, None] * 0.75**0.5, x.shape)
    return centre + spacing * np.stack([x.ravel(), y.ravel()], axis=1)


def inside(points: np.ndarray, rings: list[np.ndarray]) -> np.ndarray:
    """Return which points lie inside, by the parity of the crossings of a ray to the right."""
    found = np.zeros(len(points), dtype=bool)
    x, y = points[:, :1], points[:, 1:]
    for ring in rings:
        a, b = ring, np.roll(ring, -1, axis=0)
        across = (a[:, 1] > y) != (b[:, 1] > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            meets = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
        found ^= (across & (meets > x)).sum(axis=1) % 2 == 1
    return found


def distance(points: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Return the distances (N,) of points to the nearest points of a border."""
    from scipy.spatial import cKDTree

    return cKDTree(border).query(points)[0]


def _counter_clockwise(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = np.where((area < 0)[:, None], triangles[:, ::-1], triangles)
    return triangles[np.abs(area) > 1e-12 * np.abs(area).max()]


def _bounded_by(triangles: np.ndarray, rings: list[np.ndarray]) -> bool:
    """Return whether the boundary of the triangles is exactly the outlines, each edge once and in its direction."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    present = set(map(tuple, edges.tolist()))
    open_edges = {edge for edge in present if edge[::-1] not in present}
    wanted, start = set(), 0
    for ring in rings:
        n = len(ring)
        wanted |= {(start + k, start + (k + 1) % n) for k in range(n)}
        start += n
    return len(present) == len(edges) and open_edges == wanted


def unite(*outlines: np.ndarray) -> list[np.ndarray]:
    """Return the outlines of the union of flat regions, the longest outline first."""
    return _combine(outlines, "Add")


def half_plane(*outlines: np.ndarray) -> np.ndarray:
    """Return the outline of a union of flat regions, cut at x = 0: the section of a body of revolution."""
    joined = unite(*outlines)[0]
    low, high = joined.min(axis=0) - 1, joined.max(axis=0) + 1
    right = np.array([(0.0, low[1]), (high[0], low[1]), (high[0], high[1]), (0.0, high[1])])
    return _combine((joined, right), "Intersect")[0]


def subtract(outline: np.ndarray, *others: np.ndarray) -> list[np.ndarray]:
    """Return the outlines of a flat region minus others, the longest first; holes are clockwise."""
    return _combine((outline, *others), "Subtract")


def _combine(outlines, operation: str) -> list[np.ndarray]:
    from manifold3d import CrossSection, OpType

    regions = [CrossSection([np.ascontiguousarray(outline, dtype=np.float64)]) for outline in outlines]
    joined = CrossSection.batch_boolean(regions, getattr(OpType, operation))
    rings = [np.asarray(ring, dtype=np.float64) for ring in joined.to_polygons()]
    return sorted(rings, key=len, reverse=True)


def soften(outlines: list[np.ndarray], inward: float, outward: float) -> list[np.ndarray]:
    """Round the corners of a flat region: concave ones with radius ``inward``, convex ones with ``outward``."""
    from manifold3d import CrossSection, JoinType

    region = CrossSection([np.ascontiguousarray(outline, dtype=np.float64) for outline in outlines])
    for radius in (inward, -inward - outward, outward):
        region = region.offset(radius, JoinType.Round, circular_segments=48)
    return sorted(
        (np.asarray(ring, dtype=np.float64) for ring in region.to_polygons()), key=len, reverse=True
    )
