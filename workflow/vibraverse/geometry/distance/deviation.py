"""Sampled Hausdorff distance between two surfaces.

The one-sided Hausdorff distance ``max_a min_b |a - b|`` is sampled at the vertices and at the centres of smaller
triangles: each triangle with a longest edge L is divided into k² equal ones, ``k = ⌈L / h⌉``. Every point of the
surface is then within ``2h/3`` of a sample. The distance to a surface changes no faster than the position, so the
sampled maximum misses the true one by at most ``2h/3``. ``h`` is 1 % of the diagonal, or larger to limit the number of
samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.distance.boxes import contains
from vibraverse.geometry.distance.closest import ClosestPoint

#: Wanted spacing h as a share of the diagonal, and the most samples of a surface.
_SAMPLE_SPACING, _MAX_SAMPLES = 0.01, 40_000
#: Points farther from the other surface than this share of the diagonal were swallowed or invented.
_FAR_DISTANCE = 0.01
#: Points closer than this share of the diagonal lie on the other surface.
_CONTACT_DISTANCE = 1e-9


@dataclass(frozen=True)
class Deviation:
    """Difference between a body's surface and its source mesh; distances are shares of the body's diagonal.

    Distances from the source are those to the solid body: points of the source inside it count as swallowed, not lost,
    because they are invisible. Distances from the body are those of its surface.
    """

    source_to_body: float
    """Largest distance from a point of the source to the body: what was lost."""
    body_to_source: float
    """Largest distance from a point of the body to the source: what was invented."""
    hausdorff: float
    """The larger of the two."""
    mean_source_to_body: float
    """Mean over the area of the source."""
    mean_body_to_source: float
    """Mean over the area of the body."""
    swallowed: float
    """Share of the source's area that lies deeper inside the body than 1 % of the diagonal."""
    invented: float
    """Share of the body's area that lies farther from the source than 1 % of the diagonal."""
    sampling_error: float
    """Bound on the sampling error of the largest distances."""


#: Deviation of a surface identical to the source's.
EXACT = Deviation(*[0.0] * 8)


def deviation(source: Mesh, body: Mesh, dropped: list[Mesh]) -> Deviation:
    """Return the deviation of a closed ``body`` from ``source``, ignoring source points nearer to ``dropped``."""
    diagonal = float(np.linalg.norm(np.ptp(body[0], axis=0)))
    there, weights, spacing = samples(*source, _SAMPLE_SPACING * diagonal)
    to_body = ClosestPoint(*body).distance(there)
    for part in dropped:
        stays = to_body <= ClosestPoint(*part).distance(there)
        there, weights, to_body = there[stays], weights[stays], to_body[stays]
    off = np.flatnonzero(to_body > _CONTACT_DISTANCE * diagonal)
    inside = off[contains(*body, there[off])]
    swallowed = float(weights[inside] @ (to_body[inside] > _FAR_DISTANCE * diagonal))
    to_body[inside] = 0.0
    here, areas, own_spacing = samples(*body, _SAMPLE_SPACING * diagonal)
    to_source = ClosestPoint(*source).distance(here)
    total = max(float(weights.sum()), 1e-300)
    lost = float(to_body.max(initial=0.0)) / diagonal
    made = float(to_source.max()) / diagonal
    return Deviation(
        source_to_body=lost,
        body_to_source=made,
        hausdorff=max(lost, made),
        mean_source_to_body=float(weights @ to_body) / total / diagonal,
        mean_body_to_source=float(areas @ to_source / areas.sum()) / diagonal,
        swallowed=swallowed / total,
        invented=float(areas @ (to_source > _FAR_DISTANCE * diagonal) / areas.sum()),
        sampling_error=2 / 3 * max(spacing, own_spacing) / diagonal,
    )


def samples(vertices: np.ndarray, faces: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return samples of a surface (N, 3), the area that each represents (N,), and their spacing h.

    The spacing is the wanted one, or larger to stay below ``_MAX_SAMPLES`` samples besides one per face.
    """
    longest = surfaces.edge_lengths(vertices, faces).max(axis=1)
    areas = surfaces.normals_and_areas(vertices, faces)[1]
    while (cuts := np.ceil(longest / spacing).clip(1).astype(np.int64)) @ cuts > _MAX_SAMPLES + len(faces):
        spacing *= 1.25
    points, weights = [vertices], [np.zeros(len(vertices))]
    for k in np.unique(cuts):
        which = np.flatnonzero(cuts == k)
        i, j = np.divmod(np.arange(k * k), k)
        # Cells of a square. Those beyond the diagonal are folded back and give the triangles that stand on a tip.
        beyond = i + j >= k
        u = np.where(beyond, k - i - 1 / 3, i + 1 / 3) / k
        v = np.where(beyond, k - j - 1 / 3, j + 1 / 3) / k
        a, b, c = surfaces.corners(vertices, faces[which])
        points.append(
            (a[:, None] + u[:, None] * (b - a)[:, None] + v[:, None] * (c - a)[:, None]).reshape(-1, 3)
        )
        weights.append(np.repeat(areas[which] / k**2, k * k))
    return np.concatenate(points), np.concatenate(weights), float(min(spacing, longest.max()))
