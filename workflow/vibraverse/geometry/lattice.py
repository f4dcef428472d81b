"""Tetrahedra inside a level set on a lattice, with derivatives: marching tetrahedra for volumes.

A lattice of cubes, six tetrahedra each, carries a signed distance at its points. Tetrahedra that the surface crosses
are cut where the distance, linear along each edge, is zero. A vertex of the result lies on an edge of the lattice or at
one of its points, so its position is a smooth function of the distances at the two ends, as long as no sign changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations

import numpy as np

#: Least and largest share of an edge at which the surface may cut it; nearer cuts would make slivers.
MARGIN = 0.02
#: The ends of a tetrahedron's corners and edges, by their numbers in the table.
_ENDS = [(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


@dataclass(frozen=True)
class Cut:
    """The inside of a level set: ``vertices`` (V, 3) and tetrahedra ``cells`` (T, 4), positively oriented.

    A vertex lies at ``(1 - share) * a + share * b`` between the lattice's points ``ends`` (V, 2) = (a, b); both are the
    same at a point of the lattice. ``slopes`` (V, 2) are the derivatives of the share by the distances at a and b, and
    ``edges`` (V, 3) the vectors from a to b.
    """

    vertices: np.ndarray
    cells: np.ndarray
    ends: np.ndarray
    slopes: np.ndarray
    edges: np.ndarray

    def pull_back(self, by_vertices: np.ndarray, points: int) -> np.ndarray:
        """Return derivatives by the lattice's distances (…, points) from those by the vertices (…, V, 3)."""
        along = np.einsum("...vc,vc->...v", by_vertices, self.edges)
        found = np.zeros((*along.shape[:-1], points))
        for end in range(2):
            np.add.at(found, (..., self.ends[:, end]), along * self.slopes[:, end])
        return found


def lattice(cells: int, half: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return points ((cells + 1)³, 3) of [-half, half]³ and tetrahedra (6 cells³, 4), vertices ascending in each.

    Every cube is cut along the same diagonal, so neighbours agree on their common sides.
    """
    side = cells + 1
    axis = np.linspace(-half, half, side)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    steps = np.array([side * side, side, 1])
    paths = np.array([np.cumsum([0, *steps[list(order)]]) for order in permutations(range(3))])
    first = np.arange(cells)
    origins = (first[:, None, None] * steps[0] + first[:, None] * steps[1] + first).ravel()
    return points, (origins[:, None, None] + paths).reshape(-1, 4)


def inside(points: np.ndarray, tets: np.ndarray, distance: np.ndarray) -> Cut:
    """Return what lies inside, where ``distance`` (N,) at the lattice's ``points`` (N, 3) is negative.

    ``tets`` (T, 4) have ascending vertices, as those of :func:`lattice`. Only the largest connected part is kept. The
    result has no tetrahedra if no distance is negative.
    """
    negative = distance < 0.0
    patterns = negative[tets] @ (1 << np.arange(4))
    found = []
    for pattern, pieces in enumerate(_TABLE):
        if len(pieces):
            ends = tets[patterns == pattern][:, _ENDS]  # (t, 10, 2)
            found.append(ends[:, pieces].reshape(-1, 4, 2))
    corners = np.concatenate(found) if found else np.empty((0, 4, 2), dtype=tets.dtype)
    ends, cells = np.unique(corners.reshape(-1, 2), axis=0, return_inverse=True)
    cells = _largest(cells.reshape(-1, 4))
    used, cells = np.unique(cells, return_inverse=True)
    ends, cells = ends[used], cells.reshape(-1, 4)

    at_a, at_b = distance[ends].T
    cut = ends[:, 0] != ends[:, 1]
    gap = np.where(cut, at_a - at_b, 1.0)
    share = np.where(cut, at_a / gap, 0.0)
    free = cut & (share > MARGIN) & (share < 1.0 - MARGIN)
    slopes = np.stack([-at_b, at_a], axis=1) / gap[:, None] ** 2 * free[:, None]
    share = np.where(cut, np.clip(share, MARGIN, 1.0 - MARGIN), 0.0)
    edges = points[ends[:, 1]] - points[ends[:, 0]]
    vertices = points[ends[:, 0]] + share[:, None] * edges
    return Cut(vertices, _oriented(vertices, cells), ends, slopes, edges)


def _pieces(within: list[int]) -> list[tuple[int, ...]]:
    """Return the tetrahedra, of corners and edges, that fill what lies within a tetrahedron's corners ``within``.

    A side that is cut to a quadrilateral gets the diagonal from its lower corner, in both of its tetrahedra.
    """
    outside = [corner for corner in range(4) if corner not in within]

    def cut(a: int, b: int) -> int:
        return _ENDS.index((min(a, b), max(a, b)))

    def prism(a: int, b: int, c: int, over_a: int, over_b: int, over_c: int) -> list[tuple[int, ...]]:
        return [(a, over_a, over_b, over_c), (a, b, over_b, over_c), (a, b, c, over_c)]

    match within:
        case []:
            return []
        case [a]:
            return [(a, *(cut(a, other) for other in outside))]
        case [a, b]:
            c, d = outside
            return prism(a, cut(a, c), cut(a, d), b, cut(b, c), cut(b, d))
        case [a, b, c]:
            return prism(a, b, c, *(cut(corner, outside[0]) for corner in within))
        case _:
            return [tuple(within)]


#: For each of the 16 patterns of corners inside (bit i for corner i): the tetrahedra (n, 4) of corners and edges.
_TABLE = [
    np.array(_pieces([corner for corner in range(4) if pattern >> corner & 1]), dtype=int).reshape(-1, 4)
    for pattern in range(16)
]


def _largest(cells: np.ndarray) -> np.ndarray:
    """Return the tetrahedra of the largest part that holds together by its faces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(cells):
        return cells
    count = len(cells)
    sides = np.sort(cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    unique, side = np.unique(sides, axis=0, return_inverse=True)
    links = np.repeat(np.arange(count), 4), count + side.ravel()
    size = count + len(unique)
    graph = coo_array((np.ones(4 * count), links), shape=(size, size))
    part = connected_components(graph, directed=False)[1][:count]
    return cells[part == np.bincount(part).argmax()]


def _oriented(vertices: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return tetrahedra with positive volumes."""
    corners = vertices[cells]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    return np.where((volumes < 0.0)[:, None], cells[:, [0, 1, 3, 2]], cells)
