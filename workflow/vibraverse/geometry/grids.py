"""Voxels and signed distance on the cell centres of [-1, 1]³.

The samples lie as in :mod:`vibraverse.geometry.voxels`. The distance to the triangles is exact. Its sign comes from one
ray along z through every column of cells, 16,384 rays for 128³ cells. A ray enters the body where it hits a face from
outside and leaves where it hits one from inside. If its entries and exits do not alternate, it has hit an edge twice;
then it is shifted slightly and cast again.
"""

from __future__ import annotations

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry.surfaces import normals_and_areas
from vibraverse.geometry.voxels import cell_centres

#: Sideways shift of a ray that grazes an edge, in cells per attempt, and the number of attempts.
_JITTER = 1e-4
_MAX_ATTEMPTS = 12
#: Distances are rounded to multiples of this.
QUANTUM = 2.0**-20


class Sampler:
    """Sampler of a closed surface (V, 3), (F, 3) inside [-1, 1]³ on grids of any resolution."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, threads: int = 1):
        from open3d.t.geometry import RaycastingScene

        self._threads = threads
        self._surface = vertices, faces
        # Along +z a ray enters through a face whose normal points down.
        self._entering = -np.sign(normals_and_areas(vertices, faces)[0][:, 2]).astype(np.int64)
        self._scene = RaycastingScene(nthreads=threads)
        self._scene.add_triangles(
            np.ascontiguousarray(vertices, dtype=np.float32), np.ascontiguousarray(faces, dtype=np.uint32)
        )

    def occupancy(self, n: int) -> np.ndarray:
        """Return which cell centres lie inside, (n, n, n) bool.

        Raises :class:`Refused` with reason ``too_thin`` when the entries and exits of a ray do not alternate. Then the
        surface is open, or its sides are closer than single precision resolves.
        """
        x = cell_centres(n)
        column_x, column_y = np.repeat(x, n), np.tile(x, n)
        inside = np.zeros((n * n, n), dtype=bool)
        pending = np.arange(n * n)
        generator = np.random.Generator(np.random.PCG64(0))
        for attempt in range(_MAX_ATTEMPTS):
            shift = _JITTER * (x[1] - x[0]) * attempt * generator.uniform(-1, 1, (2, len(pending)))
            found, alternate = self._columns(column_x[pending] + shift[0], column_y[pending] + shift[1], x)
            inside[pending[alternate]] = found[alternate]
            pending = pending[~alternate]
            if not len(pending):
                return inside.reshape(n, n, n)
        raise Refused(
            "too_thin",
            f"{len(pending)} of {n * n} rays do not enter and leave the body alternately: it is thinner there than "
            "a ten-millionth of its length, or its surface is open.",
            "Thicken the body there, or close its surface, in the program that made it.",
        )

    def signed_distance(self, n: int) -> np.ndarray:
        """Return the signed distance at the cell centres, (n, n, n) float32, negative inside.

        Distances are in the units of the surface, rounded to multiples of 2⁻²⁰ (about 1e-6), which compress well.
        Rounding never changes their sign.
        """
        from vibraverse.geometry.distance.field import grid_distance

        x = cell_centres(n)
        steps = np.maximum(np.round(grid_distance(*self._surface, x, x, x) / QUANTUM), 1.0)
        return (np.where(self.occupancy(n), -QUANTUM, QUANTUM) * steps).astype(np.float32)

    def _columns(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return which cells along rays at ``x``, ``y`` are inside (C, nz), and which rays alternate (C,)."""
        start = -2.0
        rays = np.zeros((len(x), 6), dtype=np.float32)
        rays[:, 0], rays[:, 1], rays[:, 2], rays[:, 5] = x, y, start, 1.0
        hits = self._scene.list_intersections(rays, nthreads=self._threads)
        ray = hits["ray_ids"].numpy().astype(np.int64)
        height = hits["t_hit"].numpy().astype(np.float64) + start
        entering = self._entering[hits["primitive_ids"].numpy()]
        order = np.lexsort((-entering, height, ray))
        ray, height, entering = ray[order], height[order], entering[order]
        # Entries minus exits after each hit. Any value but 0 and 1 means that the ray hit an edge twice.
        depth = np.cumsum(entering)
        before = np.concatenate([[0], depth])[np.searchsorted(ray, np.arange(len(x)))]
        depth = depth - before[ray]
        alternate = np.ones(len(x), dtype=bool)
        alternate[ray[(depth < 0) | (depth > 1) | (entering == 0)]] = False
        alternate &= np.bincount(ray, entering, minlength=len(x)) == 0
        crossings = np.zeros((len(x), len(z) + 1), dtype=np.int32)
        np.add.at(crossings, (ray, np.searchsorted(z, height)), entering)
        return np.cumsum(crossings, axis=1)[:, :-1] == 1, alternate


def thickest_cell(distance: np.ndarray, n: int) -> np.ndarray:
    """Return the occupancy (n, n, n) of a body too thin to hold a cell centre.

    The cell that contains the deepest sample of the signed ``distance`` counts as occupied, so no body vanishes.
    """
    occupied = np.zeros((n, n, n), dtype=bool)
    deepest = np.unravel_index(int(distance.argmin()), distance.shape)
    occupied[tuple(int((i + 0.5) / distance.shape[0] * n) for i in deepest)] = True
    return occupied
