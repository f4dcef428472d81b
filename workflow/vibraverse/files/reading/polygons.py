"""Vertices and polygons as they are read, in flat arrays; polygons cut into triangles; parts put in their places."""

from __future__ import annotations

import array
from dataclasses import dataclass, field

import numpy as np

from vibraverse.files.reading.bounds import MAX_PARTS, Bounds
from vibraverse.geometry import Mesh

#: Corners that are looked at together, so that memory stays small.
_AT_ONCE = 1 << 18

#: Corners of a concave polygon; cutting one that crosses itself takes time with the square of them.
_MAX_CONCAVE = 5000


@dataclass
class Polygons:
    """Polygons of any number of corners in two flat arrays, eight bytes a number.

    ``corners`` are vertex indices of all polygons in a row, ``sizes`` how many of them each polygon has.
    """

    bounds: Bounds
    corners: array.array = field(default_factory=lambda: array.array("q"))
    sizes: array.array = field(default_factory=lambda: array.array("q"))

    def add(self, corners: list[int]) -> None:
        """Append one polygon; raises :class:`TooLarge` beyond the limit, ``ValueError`` for a corner beyond 64 bits."""
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
    """Vertices that are read one by one into a flat array of doubles."""

    bounds: Bounds
    values: array.array = field(default_factory=lambda: array.array("d"))

    def __len__(self) -> int:
        return len(self.values) // 3

    def add(self, x: float, y: float, z: float) -> None:
        """Append one vertex; raises :class:`TooLarge` beyond the limit."""
        self.values.extend((x, y, z))
        if len(self.values) > 3 * self.bounds.max_vertices:
            self.bounds.check(vertices=len(self))

    def array(self) -> np.ndarray:
        """Return the vertices (V, 3) float64."""
        return np.array(self.values, dtype=np.float64).reshape(-1, 3)


@dataclass
class Parts:
    """The parts of a scene, put where their transforms say and counted against the limits."""

    bounds: Bounds
    vertices: list[np.ndarray] = field(default_factory=list)
    faces: list[np.ndarray] = field(default_factory=list)
    _vertices: int = field(default=0, init=False)
    _faces: int = field(default=0, init=False)

    def __len__(self) -> int:
        return len(self.vertices)

    def add(self, points: np.ndarray, triangles: np.ndarray, matrix: np.ndarray) -> None:
        """Append a part (V, 3), (F, 3) where ``matrix`` (4, 3), whose last row is the shift, puts it.

        A mirrored part keeps its outside outside. Raises :class:`TooLarge` or ``ValueError`` beyond the limits.
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
    """Cut polygons into triangles (F, 3) that keep their order and orientation and do not leave a concave outline.

    ``corners`` are the indices of all polygons in a row, ``sizes`` (P,) how many each has, at least three.
    Polygons with a corner out of range become fans as they are, for the caller to report.
    """
    if (sizes == 3).all():
        return corners.reshape(-1, 3)
    begin = np.cumsum(sizes) - sizes
    goal = np.cumsum(sizes - 2) - (sizes - 2)
    triangles = np.empty((int((sizes - 2).sum()), 3), dtype=np.int64)
    for size in np.unique(sizes):
        which = np.flatnonzero(sizes == size)
        for some in np.array_split(which, len(which) * size // _AT_ONCE + 1):
            loops = corners[begin[some][:, None] + np.arange(size)]
            triangles[goal[some][:, None] + np.arange(size - 2)] = _cut(vertices, loops)
    return triangles


def _fans(loops: np.ndarray) -> np.ndarray:
    """Return the triangles (P, n - 2, 3) from each loop's first corner; ``loops`` (P, n)."""
    first = np.broadcast_to(loops[:, :1], (len(loops), loops.shape[1] - 2))
    return np.stack([first, loops[:, 1:-1], loops[:, 2:]], axis=2)


def _turns(vertices: np.ndarray, loops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each loop's area vector (P, 3), twice its area long, and how each corner turns about it (P, n)."""
    points = vertices[loops] - vertices[loops[:, :1]]
    following = np.roll(points, -1, axis=1)
    normal = np.cross(points, following).sum(axis=1)  # Newell
    bends = np.cross(points - np.roll(points, 1, axis=1), following - points)
    return normal, np.einsum("pni,pi->pn", bends, normal)


def _cut(vertices: np.ndarray, loops: np.ndarray) -> np.ndarray:
    """Return the triangles (P, n - 2, 3) of loops (P, n) that have the same number of corners."""
    fans = _fans(loops)
    known = np.flatnonzero(((loops >= 0) & (loops < len(vertices))).all(axis=1))
    if loops.shape[1] == 3 or not len(known):
        return fans
    normal, turns = _turns(vertices, loops[known])
    concave = np.flatnonzero((turns < 0).any(axis=1))
    if loops.shape[1] == 4:  # the cut of a concave quadrilateral begins at its inward corner
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
    """Cut a concave polygon in the plane of its area vector."""
    import manifold3d

    if len(loop) > _MAX_CONCAVE:
        raise ValueError(
            f"a face has {len(loop)} corners and turns inwards; more than {_MAX_CONCAVE} are not cut"
        )
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    flat = points @ np.stack([across, np.cross(normal, across)], axis=1)
    cut = np.asarray(manifold3d.triangulate([flat])).reshape(-1, 3)
    if len(cut) != len(loop) - 2:
        return _fans(loop[None])[0]
    return loop[cut]
