"""A solid as a bundle of rods, cut by a grid of cells: what hangs together, and the moments of each part.

Parallel lines, many in each cell, cross the solid along z. Each stretch inside it is a rod, exact along the line, and
as wide as the lines are apart. Segments of rods in one cell that touch form a part of the solid in that cell,

    m_abc = ∫ r^a s^b t^c dV,   a, b, c <= 4,   r, s, t from 0 to 1 in the cell.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

#: Lines along the longest side of the box, at least.
LINES = 256
#: Where lines stand in their squares, off the middle by so much that none meets an edge of a symmetric body.
_PLACE = np.array([0.5 + 1.4142e-6, 0.5 - 1.7321e-6])
#: Neighbouring rods whose ends are closer than so many distances of lines count as touching: a steep thin wall is one.
_REACH = 1.0


@dataclass(frozen=True)
class Rods:
    """Segments of rods, each within one cell, ascending along each line.

    ``line`` (n, 2) is the place of a segment's line, ``ends`` (n, 2) are its ends in the cell from 0 to 1, ``rod`` (n,)
    numbers the rods. ``cell`` (n, 3) is the segment's, ``shape`` (2,) the number of lines, ``per_cell`` that along a
    side of a cell. ``reach`` is the distance of lines as a share of a cell's height.
    """

    line: np.ndarray
    ends: np.ndarray
    rod: np.ndarray
    cell: np.ndarray
    shape: np.ndarray
    per_cell: int
    reach: float

    @cached_property
    def links(self) -> np.ndarray:
        """Pairs (2, k) of segments that touch."""
        return np.concatenate([self._along(), *map(self._beside, range(2))], axis=1)

    def in_one_piece(self) -> Rods:
        """Return the rods without those that touch the others nowhere: a wall thinner than the lines are apart."""
        piece = groups(len(self.rod), *self.links)
        kept = piece == np.bincount(piece, np.ptp(self.ends, axis=1)).argmax()
        if kept.all():
            return self
        return replace(self, **{name: getattr(self, name)[kept] for name in ("line", "ends", "rod", "cell")})

    def parts(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the part (n,) that each segment belongs to, and pairs (k, 2) of parts that touch across cells."""
        first, second = self.links
        same = (self.cell[first] == self.cell[second]).all(axis=1)
        part = groups(len(self.rod), first[same], second[same])
        pairs = np.stack([part[first[~same]], part[second[~same]]], axis=1)
        return part, np.unique(pairs, axis=0)

    def cells_of(self, part: np.ndarray) -> np.ndarray:
        """Return the cells (p, 3) of parts."""
        return self.cell[np.unique(part, return_index=True)[1]]

    def moments(self, part: np.ndarray) -> np.ndarray:
        """Return the moments (p, 5, 5, 5) of the parts, in units of a cell."""
        order = np.arange(5)
        within = (self.line - self.per_cell * self.cell[:, :2] + _PLACE) / self.per_cell
        across = within[:, :, None] ** order / self.per_cell
        flat = (across[:, 0, :, None] * across[:, 1, None, :]).reshape(-1, 25)
        along = (self.ends[:, 1, None] ** (order + 1) - self.ends[:, 0, None] ** (order + 1)) / (order + 1)
        segments = np.arange(len(part))
        found = [sp.csr_matrix((one, (part, segments))) @ flat for one in along.T]
        return np.stack(found, axis=2).reshape(-1, 5, 5, 5)

    def _along(self) -> np.ndarray:
        """Return the pairs (2, k) of segments that follow each other in a rod."""
        first = np.flatnonzero(self.rod[1:] == self.rod[:-1])
        return np.stack([first, first + 1])

    def _beside(self, axis: int) -> np.ndarray:
        """Return the pairs (2, k) of segments on neighbouring lines along an axis that touch in one layer of cells."""
        layers = int(self.cell[:, 2].max()) + 1
        key = (self.line[:, 0] * self.shape[1] + self.line[:, 1]) * layers + self.cell[:, 2]
        count = np.bincount(key, minlength=self.shape.prod() * layers)
        start = np.cumsum(count) - count
        inner = np.flatnonzero(self.line[:, axis] + 1 < self.shape[axis])
        beside = key[inner] + layers * (self.shape[1] if axis == 0 else 1)
        found = []
        for rank in range(int(count.max())):
            there = rank < count[beside]
            one, other = inner[there], start[beside[there]] + rank
            apart = np.maximum(self.ends[one, 0], self.ends[other, 0]) - np.minimum(
                self.ends[one, 1], self.ends[other, 1]
            )
            touch = apart < self.reach
            found.append(np.stack([one[touch], other[touch]]))
        return np.concatenate(found, axis=1)


def groups(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the number (n,) of the connected group of each of ``count`` nodes, linked in pairs."""
    links = sp.coo_matrix((np.ones(len(first), dtype=bool), (first, second)), shape=(count, count))
    return connected_components(links, directed=False)[1]


def cut_rods(corners: np.ndarray, faces: np.ndarray, cells: np.ndarray, flatness: float) -> Rods:
    """Return the rods of the solid in a closed surface, cut by the cells.

    ``corners`` (V, 3) are in cells, from 0 to ``cells`` (3,) along each axis; a cell is ``flatness`` times as wide as
    high. A line that does not enter and leave alternately, by rounding, is left out.
    """
    per_cell = int(max(1, np.ceil(LINES / cells.max())))
    shape = cells[:2] * per_cell
    line, height, sign = _crossings(corners * [per_cell, per_cell, 1], faces, shape)
    order = np.lexsort((height, line))
    line, height, sign = line[order], height[order], sign[order]
    count = np.bincount(line, minlength=shape.prod())
    rank = np.arange(len(line)) - (np.cumsum(count) - count)[line]
    wrong = np.zeros(shape.prod(), dtype=bool)
    wrong[line[(sign > 0) != (rank % 2 == 1)]] = True
    kept = ~(wrong | (count % 2 == 1))[line]
    line, enter, leave = line[kept][::2], height[kept][::2], height[kept][1::2]
    bottom = np.clip(np.floor(enter), 0, cells[2] - 1).astype(int)
    top = np.clip(np.ceil(leave) - 1, bottom, cells[2] - 1).astype(int)
    layers = top - bottom + 1
    rod = np.repeat(np.arange(len(line)), layers)
    layer = bottom[rod] + np.arange(len(rod)) - (np.cumsum(layers) - layers)[rod]
    place = np.stack(np.divmod(line[rod], shape[1]), axis=1)
    return Rods(
        line=place,
        ends=np.clip(np.stack([enter[rod], leave[rod]], axis=1) - layer[:, None], 0.0, 1.0),
        rod=rod,
        cell=np.column_stack([place // per_cell, layer]),
        shape=shape,
        per_cell=per_cell,
        reach=_REACH * flatness / per_cell,
    )


def _crossings(corners: np.ndarray, faces: np.ndarray, shape: np.ndarray):
    """Return where lines along z cross a surface: number of the line, height, and +1 where it leaves the solid.

    There is a line near the middle of every unit square of the plane; ``shape`` (2,) is their number along x and y.
    """
    a, b, c = (corners[faces[:, corner]] for corner in range(3))
    first = np.ceil(np.minimum(np.minimum(a, b), c)[:, :2] - _PLACE).astype(int)
    last = np.floor(np.maximum(np.maximum(a, b), c)[:, :2] - _PLACE).astype(int)
    count = np.maximum(last - first + 1, 0)
    both = count.prod(axis=1)
    face = np.repeat(np.arange(len(faces)), both)
    rank = np.arange(len(face)) - np.repeat(np.cumsum(both) - both, both)
    place = first[face] + np.stack(np.divmod(rank, np.maximum(count[face, 1], 1)), axis=1)
    u, v, at = b - a, c - a, place + _PLACE - a[face, :2]
    twice_area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    upright = twice_area == 0  # no line crosses it
    area = np.where(upright, 1.0, twice_area)[face]
    along = (at[:, 0] * v[face, 1] - at[:, 1] * v[face, 0]) / area
    across = (u[face, 0] * at[:, 1] - u[face, 1] * at[:, 0]) / area
    hit = (along >= 0) & (across >= 0) & (along + across <= 1) & ~upright[face]
    face, place = face[hit], place[hit]
    height = a[face, 2] + along[hit] * u[face, 2] + across[hit] * v[face, 2]
    return place[:, 0] * shape[1] + place[:, 1], height, np.sign(twice_area[face])
