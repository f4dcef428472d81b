"""Exact distance to a surface on a whole grid, a few times faster than point by point.

Neighbouring points have nearly the same closest triangles. So the grid is halved along every axis, again and again.
Each block keeps the triangles that can be closest to any of its points: those whose distance from its centre exceeds
the smallest one by at most the block's width. In the end a point has some dozen candidates of 13,000 triangles; for
most of them the disc around the triangle suffices.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vibraverse.geometry.distance.triangles import nearest, tabulate

#: Discs and thresholds are enlarged by this share, which exceeds the rounding error.
_ROUNDING_MARGIN = 1e-9


def grid_distance(
    vertices: np.ndarray, faces: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """Return the unsigned distance to a surface (V, 3), (F, 3) at the grid points, (nx, ny, nz) float64."""
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    size = len(corners)
    levels = 2 + int(np.ceil(np.log2(max(len(x), len(y), len(z)))))
    discs, ids = np.empty((levels, 7, size)), np.empty((levels, size), np.int64)
    discs[0], ids[0] = _discs(corners), np.arange(size)
    squares = np.empty((len(x), len(y), len(z)))
    _descend(size, x, y, z, tabulate(corners), discs, ids, squares)
    return np.sqrt(squares)


def _discs(corners: np.ndarray) -> np.ndarray:
    """Return the bounding disc of every triangle (7, F): centre, unit normal, radius."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    # A triangle without area has no plane; a zero normal makes its disc a ball.
    normal = np.where(length > 0, normal / np.where(length > 0, length, 1.0), 0.0)
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    return np.column_stack(
        [centre, normal, radius * (1 + _ROUNDING_MARGIN) + _ROUNDING_MARGIN * np.abs(corners).max()]
    ).T


@njit(cache=True, nogil=True)
def _descend(size, x, y, z, table, discs, ids, squares):
    """Fill ``squares`` from the ``size`` triangles of level 0: depth first, each block from those its parent kept.

    Not recursive: Numba's cache of a recursive function can be read before it is whole, when two processes compile it
    at the same time.
    """
    levels = len(discs)
    blocks = np.empty((levels, 6), dtype=np.int64)
    counts = np.empty(levels, dtype=np.int64)
    octants = np.empty(levels, dtype=np.int64)
    bounds = np.empty(size)
    blocks[0] = np.array([0, len(x), 0, len(y), 0, len(z)])
    counts[0] = size
    octants[0] = -1
    level = 0
    while level >= 0:
        block = blocks[level]
        if octants[level] < 0:
            kept = _select(level, counts[level], block, x, y, z, table, discs, ids, bounds, squares)
            if kept == 0:
                level -= 1
                continue
            counts[level + 1] = kept
            octants[level] = 0
        if octants[level] == 8:
            level -= 1
            continue
        which = octants[level]
        octants[level] += 1
        part = blocks[level + 1]
        part[0], part[1] = _half(block[0], block[1], which // 4)
        part[2], part[3] = _half(block[2], block[3], which // 2 % 2)
        part[4], part[5] = _half(block[4], block[5], which % 2)
        if part[0] < part[1] and part[2] < part[3] and part[4] < part[5]:
            level += 1
            octants[level] = -1


@njit(cache=True, nogil=True)
def _select(level, count, block, x, y, z, table, discs, ids, bounds, squares):
    """Copy the triangles that may be nearest within a block to the next level, and return how many there are.

    A block of one point is filled instead; then none are.
    """
    i0, i1, j0, j1, k0, k1 = block
    p0, p1, p2 = 0.5 * (x[i0] + x[i1 - 1]), 0.5 * (y[j0] + y[j1 - 1]), 0.5 * (z[k0] + z[k1 - 1])
    disc, own = discs[level], ids[level]
    for i in range(count):  # branch-free, so that the compiler vectorises it
        a, b, c = p0 - disc[0, i], p1 - disc[1, i], p2 - disc[2, i]
        along = a * disc[3, i] + b * disc[4, i] + c * disc[5, i]
        lateral = max(a * a + b * b + c * c - along * along, 0.0)
        beside = max(np.sqrt(lateral) - disc[6, i], 0.0)
        bounds[i] = along * along + beside * beside
    first = 0
    for i in range(1, count):
        if bounds[i] < bounds[first]:
            first = i
    best = nearest(p0, p1, p2, table, own[first])[2]
    if i1 - i0 == 1 and j1 - j0 == 1 and k1 - k0 == 1:
        for i in range(count):
            if bounds[i] < best * (1.0 + _ROUNDING_MARGIN):
                best = min(best, nearest(p0, p1, p2, table, own[i])[2])
        squares[i0, j0, k0] = best
        return 0
    width = 2.0 * np.sqrt((x[i1 - 1] - p0) ** 2 + (y[j1 - 1] - p1) ** 2 + (z[k1 - 1] - p2) ** 2)
    limit = (np.sqrt(best) + width) ** 2 * (1.0 + _ROUNDING_MARGIN)
    kept = 0
    below, theirs = discs[level + 1], ids[level + 1]
    for i in range(count):
        if bounds[i] <= limit:
            for row in range(7):
                below[row, kept] = disc[row, i]
            theirs[kept] = own[i]
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def _half(start, stop, which):
    """Return start and stop of the first or the second half of a range."""
    middle = (start + stop + 1) // 2
    return (start, middle) if which == 0 else (middle, stop)
