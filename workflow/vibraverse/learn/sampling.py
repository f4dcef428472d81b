"""Points of bodies: on surfaces, far from each other, and in space with their signed distances."""

from __future__ import annotations

import numpy as np

from vibraverse.contract.seeds import rng
from vibraverse.geometry import surfaces
from vibraverse.geometry.voxels import coarse_mesh

#: Kinds of places in space, in their order: evenly distributed, near the surface, on it.
EVEN, NEAR, ON = range(3)
#: Cells along an axis of [-1, 1]³ whose centres are the even places.
_CELLS = 128
#: Standard deviations of the distance of the places near a surface, half of them each.
_NEAR = (0.02, 0.06)
#: Places are stored as whole numbers of this unit, in which cell centres are exact.
UNIT = 2.0**-15


def sample_surface(vertices: np.ndarray, faces: np.ndarray, count: int, random) -> np.ndarray:
    """Return points (count, 6) float32, uniform on a closed surface, with the unit normals of their triangles."""
    normals, areas = surfaces.normals_and_areas(vertices, faces)
    chosen = random.choice(len(faces), size=count, p=areas / areas.sum())
    across = np.sqrt(random.random((count, 1)))
    along = random.random((count, 1))
    a, b, c = surfaces.corners(vertices, faces[chosen])
    places = (1.0 - across) * a + across * (1.0 - along) * b + across * along * c
    return np.concatenate([places, normals[chosen]], axis=1).astype(np.float32)


def voxel_cloud(voxels: np.ndarray, count: int, object_: str) -> np.ndarray:
    """Return points with normals (count, 6) on the surface of the occupied cells of a grid; always the same."""
    return sample_surface(*coarse_mesh(voxels), count, rng(object_, "voxels"))


def farthest(points: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers (count,) of points (n, 3), each farthest from those before it; the first is that of point 0.

    So the first k of them are the farthest k, for every k (Gonzalez, Theor. Comput. Sci. 38, 293, 1985).
    """
    points = np.ascontiguousarray(points.T, dtype=np.float32)
    found = np.zeros(count, dtype=np.int64)
    nearest = np.full(points.shape[1], np.inf, dtype=np.float32)
    for number in range(1, count):
        away = np.square(points - points[:, found[number - 1], None]).sum(axis=0)
        np.minimum(nearest, away, out=nearest)
        found[number] = nearest.argmax()
    return found


def distance_samples(
    vertices: np.ndarray, faces: np.ndarray, count: int, random
) -> tuple[np.ndarray, np.ndarray]:
    """Return places (3, count, 3) int16 around a closed surface in [-1, 1]³, and distances (2, count) float16.

    The places are in multiples of :data:`UNIT`, of the kinds :data:`EVEN`, :data:`NEAR` and :data:`ON`; the distances
    are those of the first two, negative inside.
    """
    even = (2 * random.integers(_CELLS, size=(count, 3)) + 1) / _CELLS - 1.0
    near, on = (sample_surface(vertices, faces, count, random)[:, :3].astype(np.float64) for _ in range(2))
    near += random.normal(size=near.shape) * np.resize(_NEAR, count)[:, None]
    highest = round(1 / UNIT) - 1
    places = np.clip(np.rint(np.stack([even, near, on]) / UNIT), -highest, highest).astype(np.int16)
    distances = signed_distance(vertices, faces, UNIT * places[[EVEN, NEAR]].reshape(-1, 3))
    return places, distances.reshape(2, count).astype(np.float16)


def signed_distance(vertices: np.ndarray, faces: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distances (n,) of points (n, 3) from a closed surface, negative inside."""
    from vibraverse.geometry.distance.boxes import contains
    from vibraverse.geometry.distance.closest import ClosestPoint

    distance = ClosestPoint(vertices, faces).distance(points)
    return np.where(contains(vertices, faces, points), -distance, distance)
