"""Closest points on a surface, in double precision.

Triangles are sorted along a Morton curve, two to a leaf of a complete binary tree. The tree needs no pointers: the
children of node ``i`` are ``2i + 1`` and ``2i + 2``. Each node is bounded by a cylinder along its mean normal. A patch
of a surface is almost flat, so its cylinder is a thin disc that excludes more points than a box would. A query starts
from the triangle that the previous query found, a good first guess when points are sorted in space.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vibraverse.geometry.distance.triangles import nearest, tabulate

#: Triangles per leaf.
_LEAF_TRIANGLES = 2
#: Cylinders are enlarged by this share of the coordinates, which exceeds the rounding error.
_ROUNDING_MARGIN = 1e-14
#: Bits per axis of a Morton code, and the shifts and masks that spread them to every third bit.
_MORTON_BITS = 21
_MORTON_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


class ClosestPoint:
    """Index of a surface (V, 3), (F, 3) that finds closest points in some 3 µs each."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        corners = np.asarray(vertices, dtype=np.float64)[faces]
        order = np.argsort(morton(corners.mean(axis=1)), kind="stable")
        leaves = 1 << int(np.ceil(np.log2(max(1.0, len(faces) / _LEAF_TRIANGLES))))
        # Copies of the last triangle fill the unused leaves.
        corners = corners[np.concatenate([order, np.full(leaves * _LEAF_TRIANGLES - len(order), order[-1])])]
        self._table, self._cylinders = tabulate(corners), _cylinders(corners, leaves)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the closest points (N, 3) to ``points`` (N, 3)."""
        return _search(np.ascontiguousarray(points, dtype=np.float64), self._table, self._cylinders)[0]

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distances (...) of ``points`` (..., 3) to the surface."""
        flat = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        return np.sqrt(_search(flat, self._table, self._cylinders)[1]).reshape(np.shape(points)[:-1])


def morton(points: np.ndarray) -> np.ndarray:
    """Return the Morton codes (N,) of points (N, 3) in their bounding cube."""
    low = points.min(axis=0)
    scale = (2**_MORTON_BITS - 1) / max(float((points - low).max()), 1e-300)
    cell = ((points - low) * scale).astype(np.uint64)
    code = np.zeros(len(points), dtype=np.uint64)
    for axis in range(3):
        spread = cell[:, axis]
        for shift, mask in _MORTON_SPREAD:
            spread = (spread | (spread << np.uint64(shift))) & np.uint64(mask)
        code |= spread << np.uint64(axis)
    return code


def _cylinders(corners: np.ndarray, leaves: int) -> np.ndarray:
    """Return the bounding cylinder of every node, the root first: (2 leaves - 1, 8).

    Columns: centre, unit axis, half the height, radius.
    """
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    levels, nodes = [], leaves
    while nodes:
        points = corners.reshape(nodes, -1, 3)
        axis = crossed.reshape(nodes, -1, 3).sum(axis=1)
        length = np.linalg.norm(axis, axis=1, keepdims=True)
        axis = np.where(length > 0, axis / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])
        centre = 0.5 * (points.min(axis=1) + points.max(axis=1))
        away = points - centre[:, None]
        height = np.einsum("npd,nd->np", away, axis)
        lateral = np.maximum(np.einsum("npd,npd->np", away, away) - height**2, 0.0).max(axis=1)
        low, high = height.min(axis=1), height.max(axis=1)
        centre += (0.5 * (low + high))[:, None] * axis
        slack = _ROUNDING_MARGIN * np.abs(points).max(axis=(1, 2))
        # Squares lose half the digits, so the radius takes the square root of the margin of the height.
        radius = np.sqrt(lateral + slack * np.abs(points).max(axis=(1, 2)))
        levels.insert(0, np.column_stack([centre, axis, 0.5 * (high - low) + slack, radius]))
        nodes //= 2
    return np.ascontiguousarray(np.concatenate(levels))


@njit(cache=True, nogil=True)
def _to_cylinder(p0, p1, p2, cylinders, i):
    """Return the squared distance from p to a cylinder."""
    x, y, z = p0 - cylinders[i, 0], p1 - cylinders[i, 1], p2 - cylinders[i, 2]
    along = x * cylinders[i, 3] + y * cylinders[i, 4] + z * cylinders[i, 5]
    above = max(abs(along) - cylinders[i, 6], 0.0)
    lateral = x * x + y * y + z * z - along * along
    radius = cylinders[i, 7]
    if lateral <= radius * radius:
        return above * above
    beside = np.sqrt(lateral) - radius
    return above * above + beside * beside


@njit(cache=True, nogil=True)
def _search(points, table, cylinders):
    """Return the closest points (N, 3) and their squared distances (N,)."""
    first_leaf = len(cylinders) // 2
    stack, bounds = np.empty(64, np.int64), np.empty(64)
    found, squares = np.empty((len(points), 3)), np.empty(len(points))
    chosen = 0
    for k in range(len(points)):
        p0, p1, p2 = points[k, 0], points[k, 1], points[k, 2]
        v, w, best = nearest(p0, p1, p2, table, chosen)
        stack[0], bounds[0], depth = 0, 0.0, 1
        while depth:
            depth -= 1
            if bounds[depth] >= best:
                continue
            node = stack[depth]
            while node < first_leaf:
                left, right = 2 * node + 1, 2 * node + 2
                near, far = (
                    _to_cylinder(p0, p1, p2, cylinders, left),
                    _to_cylinder(p0, p1, p2, cylinders, right),
                )
                if far < near:
                    left, right, near, far = right, left, far, near
                if far < best:
                    stack[depth], bounds[depth] = right, far
                    depth += 1
                if near >= best:
                    break
                node = left
            else:
                first = (node - first_leaf) * _LEAF_TRIANGLES
                for i in range(first, first + _LEAF_TRIANGLES):
                    at_v, at_w, square = nearest(p0, p1, p2, table, i)
                    if square < best:
                        chosen, best, v, w = i, square, at_v, at_w
        squares[k] = best
        for axis in range(3):
            found[k, axis] = table[chosen, axis] + v * table[chosen, 3 + axis] + w * table[chosen, 6 + axis]
    return found, squares
