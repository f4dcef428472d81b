"""Intersections between triangles of a surface: faces that cut, touch or cover each other beyond what they share.

Two convex sets are disjoint exactly when a plane separates them. For two triangles the candidates are few: the plane of
either, the planes along one edge of each, and, for coplanar triangles, those through an edge of either. Triangles that
share a point are treated as two cones that may meet only in their tip. Triangles that share an edge meet elsewhere only
if one is folded onto the other. Each sign is first computed in floating point with an error bound. The few undecided
pairs, mostly touching ones, are decided in integers. So the answer is exact for the coordinates as stored.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vibraverse.geometry.distance.boxes import box_tree

#: A sign in floating point is certain if the number exceeds this times the magnitude of its terms. The numbers
#: below have at most degree five in coordinates that are themselves rounded differences.
_ERROR_BOUND = 1e-14
_APART, _MEET, _UNDECIDED = 0, 1, 2


def crossing_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return which faces (F,) meet another face beyond the points and edges that they share.

    ``vertices`` (V, 3), ``faces`` (F, 3). Only equal indices make faces neighbours: equal points with different
    indices count as touching.
    """
    crossing = np.zeros(len(faces), dtype=bool)
    if len(faces) < 2:
        return crossing
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    order, boxes = box_tree(vertices[faces])
    pairs = _undecided(vertices, faces, order, boxes, crossing)
    for one, other in pairs[~crossing[pairs].all(axis=1)].tolist():
        if _meet_exactly(vertices, faces[one].tolist(), faces[other].tolist()):
            crossing[[one, other]] = True
    return crossing


def _undecided(vertices, faces, order, boxes, crossing) -> np.ndarray:
    """Mark the faces that certainly cross in ``crossing`` and return the undecided pairs (P, 2)."""
    room = max(1024, len(faces))
    while True:
        pairs = np.empty((room, 2), dtype=np.int64)
        count = _all_pairs(vertices, faces, order, boxes, crossing, pairs)
        if count <= room:
            return pairs[:count]
        room = count


@njit(cache=True, nogil=True)
def _all_pairs(vertices, faces, order, boxes, crossing, pairs):
    """Compare every face with the later ones whose boxes overlap its own; count the undecided pairs."""
    first_leaf, n = len(boxes) // 2, len(faces)
    stack = np.empty(128, np.int64)
    count = 0
    for k in range(n):
        one = order[k]
        own = boxes[first_leaf + k]
        stack[0], depth = 0, 1
        while depth:
            depth -= 1
            node = stack[depth]
            meet = True
            for axis in range(3):
                if boxes[node, axis] > own[3 + axis] or boxes[node, 3 + axis] < own[axis]:
                    meet = False
            if not meet:
                continue
            if node < first_leaf:
                # If the node's last leaf does not come after this face, none of its leaves does.
                last = node
                while last < first_leaf:
                    last = 2 * last + 2
                if last - first_leaf > k:
                    stack[depth], stack[depth + 1] = 2 * node + 1, 2 * node + 2
                    depth += 2
            elif k < node - first_leaf < n:
                other = order[node - first_leaf]
                if crossing[one] and crossing[other]:
                    continue
                found = _compare(vertices, faces[one], faces[other])
                if found == _MEET:
                    crossing[one] = crossing[other] = True
                elif found == _UNDECIDED:
                    if count < len(pairs):
                        pairs[count, 0], pairs[count, 1] = one, other
                    count += 1
    return count


@njit(cache=True, nogil=True)
def _compare(vertices, one, other):
    """Return whether two faces are apart, meet, or need exact arithmetic."""
    shared, i, j = 0, 0, 0
    for a in range(3):
        for b in range(3):
            if one[a] == other[b]:
                shared, i, j = shared + 1, a, b
    if shared == 3:
        return _MEET
    if shared == 2:
        return _folded(vertices, one, other)
    p, q = np.empty((3, 3)), np.empty((3, 3))
    for a in range(3):
        for axis in range(3):
            p[a, axis] = vertices[one[(i + a) % 3], axis] - vertices[one[i], axis]
            q[a, axis] = vertices[other[(j + a) % 3], axis] - vertices[one[i], axis]
    return _cones(p, q) if shared == 1 else _triangles(p, q)


@njit(cache=True, nogil=True)
def _cross(a, b):
    return np.array((a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]))


@njit(cache=True, nogil=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def _size(points):
    """Return the largest absolute coordinate."""
    most = 0.0
    for i in range(len(points)):
        for axis in range(3):
            most = max(most, abs(points[i, axis]))
    return most


@njit(cache=True, nogil=True)
def _folded(vertices, one, other):
    """Compare two faces with a common edge: apart unless coplanar and on the same side of the edge."""
    a = b = c = d = -1
    for k in range(3):
        if one[k] != other[0] and one[k] != other[1] and one[k] != other[2]:
            c, a, b = one[k], one[(k + 1) % 3], one[(k + 2) % 3]
        if other[k] != one[0] and other[k] != one[1] and other[k] != one[2]:
            d = other[k]
    edge, p, q = vertices[b] - vertices[a], vertices[c] - vertices[a], vertices[d] - vertices[a]
    normal, reference = _cross(edge, p), _cross(edge, q)
    size = max(max(np.abs(edge).max(), np.abs(p).max()), np.abs(q).max())
    if _dot(normal, reference) < -_ERROR_BOUND * size**4 or abs(_dot(normal, q)) > _ERROR_BOUND * size**3:
        return _APART
    return _UNDECIDED


@njit(cache=True, nogil=True)
def _triangles(p, q):
    """Compare two faces (3, 3) that share nothing."""
    size = max(_size(p), _size(q))
    n, m = _cross(p[1] - p[0], p[2] - p[0]), _cross(q[1] - q[0], q[2] - q[0])
    found = _MEET
    for k in range(17):
        if k < 2:
            axis, scale = (n, size**2) if k == 0 else (m, size**2)
        elif k < 11:
            i, j = (k - 2) // 3, (k - 2) % 3
            axis, scale = _cross(p[(i + 1) % 3] - p[i], q[(j + 1) % 3] - q[j]), size**2
        elif k < 14:
            axis, scale = _cross(n, p[(k - 10) % 3] - p[k - 11]), size**3
        else:
            axis, scale = _cross(m, q[(k - 13) % 3] - q[k - 14]), size**3
        low, high, under, over = np.inf, -np.inf, np.inf, -np.inf
        for i in range(3):
            at, there = _dot(axis, p[i]), _dot(axis, q[i])
            low, high, under, over = min(low, at), max(high, at), min(under, there), max(over, there)
        gap, error = max(under - high, low - over), 8 * _ERROR_BOUND * scale * size
        if gap > error:
            return _APART
        if gap > -error:
            found = _UNDECIDED
    return found


@njit(cache=True, nogil=True)
def _cones(p, q):
    """Compare two faces (3, 3) whose first corners are the same point, the origin."""
    size = max(_size(p), _size(q))
    n, m = _cross(p[1], p[2]), _cross(q[1], q[2])
    found = _MEET
    for k in range(10):
        # One cone must lie at or above zero along the axis, and the other below.
        if k == 0:
            a, b, scale = _dot(n, q[1]), _dot(n, q[2]), size**3
            same = 1
        elif k == 1:
            a, b, scale = _dot(m, p[1]), _dot(m, p[2]), size**3
            same = 1
        elif k < 6:
            i, j = 1 + (k - 2) // 2, 1 + (k - 2) % 2
            axis = _cross(p[i], q[j])
            a, b, scale = _dot(axis, p[3 - i]), _dot(axis, q[3 - j]), size**3
            same = -1
        else:
            i = 1 + k % 2
            axis, side = (_cross(n, p[i]), p[3 - i]) if k < 8 else (_cross(m, q[i]), q[3 - i])
            first, second = (q[1], q[2]) if k < 8 else (p[1], p[2])
            up = 1.0 if _dot(axis, side) > 0 else -1.0
            a, b, scale = -up * _dot(axis, first), -up * _dot(axis, second), size**4
            error = _ERROR_BOUND * scale
            if a > error and b > error and abs(_dot(axis, side)) > error:
                return _APART
            if a > -error and b > -error:
                found = _UNDECIDED
            continue
        error = _ERROR_BOUND * scale
        if abs(a) > error and abs(b) > error:
            if same * a * b > 0:
                return _APART
        else:
            found = _UNDECIDED
    return found


def _meet_exactly(vertices: np.ndarray, one: list[int], other: list[int]) -> bool:
    """Return whether two faces meet beyond what they share, in integer arithmetic.

    Doubles are integers times a power of two; all six points are scaled by their largest common power.
    """
    shared = [v for v in one if v in other]
    if len(shared) == 3:
        return True
    ratios = [[x.as_integer_ratio() for x in vertices[v].tolist()] for v in (*one, *other)]
    whole = max(below for point in ratios for _, below in point)
    place = dict(
        zip(
            (*one, *other),
            ([above * (whole // below) for above, below in point] for point in ratios),
            strict=True,
        )
    )
    if shared:
        tip = place[shared[0]]
        p = [_less(place[v], tip) for v in one if v != shared[0]]
        q = [_less(place[v], tip) for v in other if v != shared[0]]
        if len(shared) == 2:
            edge = _less(place[shared[1]], tip)
            c = _less(place[next(v for v in one if v not in shared)], tip)
            d = _less(place[next(v for v in other if v not in shared)], tip)
            n, m = _times(edge, c), _times(edge, d)
            return _on(n, d) == 0 and _on(n, m) > 0
        return not _cones_apart(p, q)
    return not _triangles_apart([place[v] for v in one], [place[v] for v in other])


def _less(a, b):
    return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]


def _times(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _on(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _axes(p_edges, q_edges, n, m):
    """Yield the normals of all candidate separating planes."""
    yield n
    yield m
    for e in p_edges:
        for f in q_edges:
            yield _times(e, f)
    # For coplanar or degenerate triangles: planes through one edge and along a normal.
    for normal in (n, m):
        for e in (*p_edges, *q_edges):
            yield _times(normal, e)


def _triangles_apart(p, q) -> bool:
    """Return whether two triangles of integer points are disjoint."""
    p_edges = [_less(p[k - 1], p[k]) for k in range(3)]
    q_edges = [_less(q[k - 1], q[k]) for k in range(3)]
    n, m = _times(p_edges[0], p_edges[1]), _times(q_edges[0], q_edges[1])
    for axis in _axes(p_edges, q_edges, n, m):
        here, there = [_on(axis, x) for x in p], [_on(axis, x) for x in q]
        if max(here) < min(there) or max(there) < min(here):
            return True
    return False


def _cones_apart(p, q) -> bool:
    """Return whether two cones of two integer directions each meet only in their tip, the origin."""
    n, m = _times(*p), _times(*q)
    for axis in _axes(p, q, n, m):
        here, there = [_on(axis, x) for x in p], [_on(axis, x) for x in q]
        for a, b in ((here, there), (there, here)):
            if max(a) <= 0 < min(b) or max(a) < 0 <= min(b):
                return True
            if max(a) == 0 == min(b) and any(axis):
                # Both touch the plane, possibly along two different rays.
                lean_a = [x for x, s in zip(p if a is here else q, a, strict=True) if s == 0]
                lean_b = [x for x, s in zip(q if a is here else p, b, strict=True) if s == 0]
                if len(lean_a) == len(lean_b) == 1 and not _same_ray(lean_a[0], lean_b[0]):
                    return True
    return False


def _same_ray(a, b) -> bool:
    """Return whether two directions are equal up to length."""
    return not any(_times(a, b)) and _on(a, b) > 0
