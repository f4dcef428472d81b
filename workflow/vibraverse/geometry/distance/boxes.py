"""A tree of bounding boxes around triangles, and the test whether a point is inside a closed surface.

The tree is binary and complete: the children of node ``i`` are ``2i + 1`` and ``2i + 2``. Its leaves hold one triangle
each, in the order of a Morton curve.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vibraverse.geometry.distance.closest import morton

#: Rays run along the third of these directions, because no modelled edge or face has it.
_RAY_FRAME = np.linalg.qr(
    np.array([[0.8346, 0.2519, 0.4899], [-0.3391, 0.9371, 0.0824], [-0.4343, -0.2417, 0.8677]])
)[0]


def box_tree(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the order of triangles (F, 3, 3) along the curve, and the boxes of the tree (2 leaves - 1, 6).

    A box is its lower and its upper corner. Boxes of unused leaves are empty.
    """
    order = np.argsort(morton(corners.mean(axis=1)), kind="stable")
    leaves = 1 << int(np.ceil(np.log2(len(corners))))
    low, high = np.full((2 * leaves - 1, 3), np.inf), np.full((2 * leaves - 1, 3), -np.inf)
    low[leaves - 1 : leaves - 1 + len(corners)] = corners[order].min(axis=1)
    high[leaves - 1 : leaves - 1 + len(corners)] = corners[order].max(axis=1)
    while leaves > 1:
        leaves //= 2
        parent, left = slice(leaves - 1, 2 * leaves - 1), slice(2 * leaves - 1, 4 * leaves - 2, 2)
        right = slice(2 * leaves, 4 * leaves - 1, 2)
        low[parent], high[parent] = np.minimum(low[left], low[right]), np.maximum(high[left], high[right])
    return order, np.hstack([low, high])


def contains(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which of ``points`` (N, 3) a closed surface (V, 3), (F, 3) encloses, (N,) bool, some µs each.

    A ray from an inner point meets the surface an odd number of times. The side on which the ray passes an edge is
    computed identically for the two faces there, so no hit is missed or counted twice.
    """
    turned = np.ascontiguousarray(vertices @ _RAY_FRAME)
    order, boxes = box_tree(turned[faces])
    return _parity(turned, np.ascontiguousarray(faces, dtype=np.int64), order, boxes, points @ _RAY_FRAME)


@njit(cache=True, nogil=True)
def _parity(vertices, faces, order, boxes, points):
    first_leaf, n = len(boxes) // 2, len(faces)
    stack, odd = np.empty(128, np.int64), np.zeros(len(points), np.bool_)
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        stack[0], depth = 0, 1
        while depth:
            depth -= 1
            node = stack[depth]
            if (
                boxes[node, 0] > x
                or boxes[node, 3] < x
                or boxes[node, 1] > y
                or boxes[node, 4] < y
                or boxes[node, 5] < z
            ):
                continue
            if node < first_leaf:
                stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node + 2
                depth += 2
            elif node - first_leaf < n and _above(vertices, faces[order[node - first_leaf]], x, y, z):
                odd[k] = not odd[k]
    return odd


@njit(cache=True, nogil=True)
def _above(vertices, face, x, y, z):
    """Return whether the upward ray from a point meets a face."""
    left, height, total = 0, 0.0, 0.0
    for i in range(3):
        a, b = face[i], face[(i + 1) % 3]
        # Starting from the vertex with the smaller number gives both faces at the edge the same arithmetic.
        low, high = min(a, b), max(a, b)
        side = (vertices[high, 0] - vertices[low, 0]) * (y - vertices[low, 1]) - (
            vertices[high, 1] - vertices[low, 1]
        ) * (x - vertices[low, 0])
        if (side >= 0.0) == (a == low):
            left += 1
        weight = side if a == low else -side
        height += weight * vertices[face[(i + 2) % 3], 2]
        total += weight
    return (left == 0 or left == 3) and total != 0.0 and height / total > z
