"""Closed triangle surfaces for tests of the geometry."""

from __future__ import annotations

import numpy as np


def ball(radius: float = 0.9, subdivisions: int = 4, centre=(0.0, 0.0, 0.0)):
    """Return an icosphere: vertices and faces."""
    from trimesh.creation import icosphere

    mesh = icosphere(subdivisions=subdivisions, radius=radius)
    return np.array(mesh.vertices) + centre, np.array(mesh.faces)


def box(sides=(1.8, 1.8, 1.8), centre=(0.0, 0.0, 0.0)):
    """Return a box of twelve triangles."""
    from trimesh.creation import box as made

    mesh = made(sides)
    return np.array(mesh.vertices) + centre, np.array(mesh.faces)


def cylinder(radius: float, height: float, sections: int = 64):
    """Return a cylinder along z whose round side has ``sections`` facets."""
    from trimesh.creation import cylinder as made

    mesh = made(radius=radius, height=height, sections=sections)
    return np.array(mesh.vertices), np.array(mesh.faces)


def bowl(radius: float, thickness: float, sections: int = 64):
    """Return a half-sphere of that outer radius, open upwards."""
    from trimesh.creation import revolve

    angle = np.linspace(0, np.pi / 2, sections // 2)
    down = np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    solid = revolve(np.concatenate([radius * down, (radius - thickness) * down[::-1]]), sections=sections)
    solid.merge_vertices()
    return np.array(solid.vertices), np.array(solid.faces)


def angle_bracket(side: float = 1.5, leg: float = 0.6, width: float = 0.8):
    """Return an L-shaped bar along y whose re-entrant edge lies on the y axis; its legs point up and to +x."""
    a, b = -leg, side - leg
    outline = np.array([(a, a), (b, a), (b, 0.0), (0.0, 0.0), (0.0, b), (a, b)])
    n = len(outline)
    vertices = np.concatenate([np.insert(outline, 1, y, axis=1) for y in (-width / 2, width / 2)])
    caps = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    walls = np.concatenate([np.stack([i, i + n, j], 1), np.stack([j, i + n, j + n], 1)])
    return vertices, np.concatenate([caps, caps[:, ::-1] + n, walls])


def together(*meshes):
    """Return several meshes as one."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return (
        np.concatenate([vertices for vertices, _ in meshes]),
        np.concatenate([faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]),
    )


def hollow_ball(radius: float = 0.9, cavity: float = 0.5, subdivisions: int = 3):
    """Return the surface of a ball with a spherical cavity."""
    outside, (points, faces) = ball(radius, subdivisions), ball(cavity, subdivisions)
    return together(outside, (points, faces[:, ::-1]))


def sheet(n: int = 12):
    """Return an open wavy sheet."""
    x, y = np.meshgrid(np.linspace(-0.9, 0.9, n), np.linspace(-0.9, 0.9, n), indexing="ij")
    vertices = np.stack([x, y, 0.2 * np.sin(3 * x) * np.cos(2 * y)], axis=-1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    return vertices, np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + 1, i + n, i + n + 1], 1)])


def split(vertices, faces):
    """Return the mesh with every triangle split into four."""
    from trimesh.remesh import subdivide

    points, cells = subdivide(vertices, faces)
    return np.array(points), np.array(cells)
