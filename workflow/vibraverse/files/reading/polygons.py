"""Growing arrays of vertices and polygons, the triangulation of polygons, and the joining of parts."""

from __future__ import annotations

import array
from dataclasses import dataclass, field

import numpy as np

from vibraverse.files.reading.bounds import MAX_PARTS, Bounds
from vibraverse.geometry import Mesh

#: Corners that are processed at once, which limits the memory.
_BATCH_CORNERS = 1 << 18

#: Most corners of a concave polygon; the time for one that crosses itself is quadratic in their number.
_MAX_CONCAVE_CORNERS = 5000


@dataclass
class Polygons:
    """Polygons with any number of corners in two flat arrays, eight bytes per number.

    ``corners`` holds the vertex indices of all polygons in sequence, ``sizes`` the number of corners of each.
    """

    bounds: Bounds
    corners: array.array = field(default_factory=lambda: array.array("q"))
    sizes: array.array = field(default_factory=lambda: array.array("q"))

    def add(self, corners: list[int]) -> None:
        """Append a polygon; raises :class:`TooLarge` beyond the limit, ``ValueError`` for an index beyond 64 bits."""
        try:
            self.corners.extend(corners)
        except OverflowError:
            raise ValueError("a face has a corner that is no number of a vertex") from None
        self.sizes.append(len(corners))
        if len(self.corners) - 2 * len(self.sizes) > self.bounds.max_triangles:
            self.bounds.check(triangles=len(self.corners) - 2 * len(self.sizes))

    def arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Return ``corners`` and ``sizes`` as arrays of int64."""
        return np.array(self.corners, dtype=np.int64), np.array(self.sizes, dtype=np.int64)


@dataclass
class Points:
    """Vertices in a flat array of doubles, read one by one."""

    bounds: Bounds
    values: array.array = field(default_factory=lambda: array.array("d"))

    def __len__(self) -> int:
        return len(self.values) // 3

    def add(self, x: float, y: float, z: float) -> None:
        """Append a vertex; raises :class:`TooLarge` beyond the limit."""
        self.values.extend((x, y, z))
        if len(self.values) > 3 * self.bounds.max_vertices:
            self.bounds.check(vertices=len(self))

    def array(self) -> np.ndarray:
        """Return the vertices (V, 3) float64."""
        return np.array(self.values, dtype=np.float64).reshape(-1, 3)


@dataclass
class Parts:
    """The parts of a scene, transformed into place and checked against the limits."""

    bounds: Bounds
    vertices: list[np.ndarray] = field(default_factory=list)
    faces: list[np.ndarray] = field(default_factory=list)
    _vertices: int = field(default=0, init=False)
    _faces: int = field(default=0, init=False)

    def __len__(self) -> int:
        return len(self.vertices)

    def add(self, points: np.ndarray, triangles: np.ndarray, matrix: np.ndarray) -> None:
        """Append a part (V, 3), (F, 3), transformed by ``matrix`` (4, 3), whose last row is the translation.

        Faces of a mirrored part are flipped, so that they face outwards. Raises :class:`TooLarge` or ``ValueError``
        beyond the limits.
        """
        self.bounds.check(vertices=self._vertices + len(points), triangles=self._faces + len(triangles))
        if len(self) == MAX_PARTS:
            raise ValueError(f"it places more than {MAX_PARTS} parts")
        mirrored = np.linalg.det(matrix[:3]) < 0
        self.vertices.append(points @ matrix[:3] + matrix[3])
        self.faces.append((triangles[:, ::-1] if mirrored else triangles) + self._vertices)
        self._vertices, self._faces = self._vertices + len(points), self._faces + len(triangles)

    def mesh(self) -> Mesh:
        """Return vertices (V, 3) and triangles (F, 3) of all parts, in their order."""
        if not self.vertices:
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        return np.concatenate(self.vertices), np.concatenate(self.faces)


def triangulate(vertices: np.ndarray, corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return the triangles (F, 3) of polygons, in their order and orientation and inside concave outlines.

    ``corners`` holds the indices of all polygons in sequence, ``sizes`` (P,) the number of each, at least three.
    Polygons with an index out of range become fans, which the caller reports.
    """
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    begin = np.cumsum(sizes) - sizes
    goal = np.cumsum(sizes - 2) - (sizes - 2)
    triangles = np.empty((int((sizes - 2).sum()), 3), dtype=np.int64)
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        for batch in np.array_split(which, len(which) * size // _BATCH_CORNERS + 1):
            loops = corners[begin[batch][:, None] + np.arange(size)]
            triangles[goal[batch][:, None] + np.arange(size - 2)] = _cut(vertices, loops)
    return triangles


def strips(corners: np.ndarray, ends: np.ndarray | None = None) -> np.ndarray:
    """Return the triangles (F, 3) of triangle strips, in their orientation: every other one is reversed.

    ``corners`` (n,) holds the indices in sequence; a strip ends where ``ends`` (n,) is true, and the next begins after
    it.
    """
    at, first = _windows(corners, ends)
    reversed_ = (at - first) % 2
    return np.stack([corners[at], corners[at + 1 + reversed_], corners[at + 2 - reversed_]], axis=1)


def fans(corners: np.ndarray, ends: np.ndarray | None = None) -> np.ndarray:
    """Return the triangles (F, 3) of triangle fans; ``corners`` and ``ends`` as for :func:`strips`."""
    at, first = _windows(corners, ends)
    return np.stack([corners[first], corners[at + 1], corners[at + 2]], axis=1)


def _windows(corners: np.ndarray, ends: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return where three corners of one strip begin (F,), and where that strip begins (F,)."""
    count = max(len(corners) - 2, 0)
    at = np.arange(count)
    if ends is None:
        return at, np.zeros_like(at)
    inside = ~(ends[:count] | ends[1 : count + 1] | ends[2 : count + 2])
    after = np.where(ends[:count], at + 1, 0)
    return at[inside], np.maximum.accumulate(after)[inside]


def _fans(loops: np.ndarray) -> np.ndarray:
    """Return the triangles (P, n - 2, 3) of ``loops`` (P, n) as fans around their first corners."""
    first = np.broadcast_to(loops[:, :1], (len(loops), loops.shape[1] - 2))
    return np.stack([first, loops[:, 1:-1], loops[:, 2:]], axis=2)


def _turns(vertices: np.ndarray, loops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the area vectors (P, 3) of loops, twice their areas long, and the turns of the corners (P, n)."""
    points = vertices[loops] - vertices[loops[:, :1]]
    following = np.roll(points, -1, axis=1)
    normal = np.cross(points, following).sum(axis=1)  # Newell
    bends = np.cross(points - np.roll(points, 1, axis=1), following - points)
    return normal, np.einsum("pni,pi->pn", bends, normal)


def _cut(vertices: np.ndarray, loops: np.ndarray) -> np.ndarray:
    """Return the triangles (P, n - 2, 3) of loops (P, n), all with the same number of corners."""
    fans = _fans(loops)
    known = np.flatnonzero(((loops >= 0) & (loops < len(vertices))).all(axis=1))
    if loops.shape[1] == 3 or not len(known):
        return fans
    normal, turns = _turns(vertices, loops[known])
    concave = np.flatnonzero((turns < 0).any(axis=1))
    if loops.shape[1] == 4:  # a concave quadrilateral is cut at its inward corner
        start = np.argmax(turns[concave] < 0, axis=1)[:, None]
        rows = known[concave]
        fans[rows] = _fans(np.take_along_axis(loops[rows], (start + np.arange(4)) % 4, axis=1))
        return fans
    for row in concave:
        loop, length = loops[known[row]], np.linalg.norm(normal[row])
        if 0 < length < np.inf:
            fans[known[row]] = _ears(vertices[loop] - vertices[loop[0]], normal[row] / length, loop)
    return fans


def _ears(points: np.ndarray, normal: np.ndarray, loop: np.ndarray) -> np.ndarray:
    """Return the triangles (n - 2, 3) of a concave polygon, cut in the plane normal to its area vector."""
    import manifold3d

    if len(loop) > _MAX_CONCAVE_CORNERS:
        raise ValueError(
            f"a face has {len(loop)} corners and turns inwards; more than {_MAX_CONCAVE_CORNERS} are not cut"
        )
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    flat = points @ np.stack([across, np.cross(normal, across)], axis=1)
    cut = np.asarray(manifold3d.triangulate([flat])).reshape(-1, 3)
    if len(cut) != len(loop) - 2:
        return _fans(loop[None])[0]
    return loop[cut]
