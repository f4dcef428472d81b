"""Distances: the tree and the grid against each other, against every triangle in turn, and against Open3D."""

from __future__ import annotations

import numpy as np
import pytest

import shapes
from vibraverse.contract.seeds import rng
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.field import grid_distance
from vibraverse.geometry.voxels import cell_centres


def _soup(random, count):
    """Triangles of very different sizes that cut each other, some of them slivers, lines and points."""
    corners = random.uniform(-0.9, 0.9, (count, 1, 3)) + random.normal(0, 0.2, (count, 3, 3)) * np.exp(
        random.uniform(-6, 0, (count, 1, 1))
    )
    corners[0:5, 2] = corners[0:5, 1]
    corners[5:10] = corners[5:10, :1]
    corners[10:15, 2] = 0.3 * corners[10:15, 0] + 0.7 * corners[10:15, 1]
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def _to_segment(points, a, b):
    """Distances (N,) of points (N, 3) to the segment from a to b."""
    along = np.clip((points - a) @ (b - a) / max((b - a) @ (b - a), 1e-300), 0, 1)
    return np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)


def _brute(points, vertices, faces):
    """The least distance over all triangles: to the plane where the foot is inside, else to an edge."""
    best = np.full(len(points), np.inf)
    for a, b, c in vertices[faces]:
        best = np.minimum.reduce([best, *(_to_segment(points, *edge) for edge in ((a, b), (b, c), (c, a)))])
        normal = np.cross(b - a, c - a)
        if np.linalg.norm(normal) < 1e-12:
            continue
        normal /= np.linalg.norm(normal)
        height = (points - a) @ normal
        foot = points - height[:, None] * normal
        inside = np.ones(len(points), bool)
        for start, stop in ((a, b), (b, c), (c, a)):
            inside &= np.cross(stop - start, foot - start) @ normal >= 0
        best = np.where(inside, np.minimum(best, np.abs(height)), best)
    return best


@pytest.mark.parametrize("count", [1, 2, 3, 40, 300])
def test_closest_points_of_a_soup(count):
    random = rng("soup", str(count))
    vertices, faces = _soup(random, max(count, 20))
    faces = faces[-count:]
    points = random.uniform(-1.2, 1.2, (400, 3))
    expected = _brute(points, vertices, faces)
    closest = ClosestPoint(vertices, faces)
    assert closest.distance(points) == pytest.approx(expected, abs=1e-12)
    found = closest(points)
    assert np.linalg.norm(found - points, axis=1) == pytest.approx(expected, abs=1e-12)
    # What is found lies on the surface: nothing is left to go.
    assert closest.distance(found).max() < 1e-12


@pytest.mark.parametrize("sides", [(1, 1, 1), (16, 16, 16), (13, 1, 7)])
def test_a_grid_measures_what_single_points_do(sides):
    vertices, faces = _soup(rng("grid"), 200)
    axes = [cell_centres(side) for side in sides]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    assert grid_distance(vertices, faces, *axes) == pytest.approx(
        ClosestPoint(vertices, faces).distance(points), abs=1e-14
    )


def test_a_grid_measures_what_open3d_does():
    from open3d.t.geometry import RaycastingScene

    vertices, faces = shapes.ball(subdivisions=4)
    vertices = vertices * [0.9, 0.5, 0.2] + [0.01, 0.02, 0.03]
    x = cell_centres(40)
    scene = RaycastingScene(nthreads=1)
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    points = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).astype(np.float32)
    assert (
        np.abs(grid_distance(vertices, faces, x, x, x) - scene.compute_distance(points).numpy()).max() < 1e-6
    )


def test_large_coordinates_lose_nothing():
    vertices, faces = shapes.box()
    offset = np.array([1e3, -2e3, 5e2])
    points = rng("far").uniform(-2, 2, (200, 3))
    near, far = ClosestPoint(vertices, faces), ClosestPoint(vertices + offset, faces)
    assert far.distance(points + offset) == pytest.approx(near.distance(points), abs=1e-11)
