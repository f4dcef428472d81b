"""Text formats of polygon meshes (OBJ, OFF) and their polygons cut into triangles.

Only what makes the surface is read: positions and the corners of faces. In OBJ indices count from 1, negative
ones backwards from the latest vertex; in OFF from 0.
"""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

Polygon = list[int]


def parse_obj(data: bytes) -> tuple[np.ndarray, list[Polygon]]:
    """Return vertices (V, 3) and polygons of an OBJ file; faces of fewer than three corners are not kept.

    Raises ``ValueError`` naming the line that cannot be read.
    """
    vertices: list[list[float]] = []
    polygons: list[Polygon] = []
    text = data.decode("utf-8", "replace").replace("\\\r\n", "  ").replace("\\\n", " ")
    for number, line in enumerate(text.split("\n"), 1):
        words = line.split()
        if not words:
            continue
        try:
            if words[0] == "v":
                x, y, z = words[1:4]
                vertices.append([float(x), float(y), float(z)])
            elif words[0] in ("f", "fo") and len(words) > 3:
                corners = [int(word.partition("/")[0]) for word in words[1:]]
                if 0 in corners:
                    raise ValueError("vertices count from 1")
                polygons.append([c - 1 if c > 0 else len(vertices) + c for c in corners])
        except ValueError:
            raise ValueError(f"line {number} is not valid: {line.strip()[:60]}") from None
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), polygons


def parse_off(data: bytes) -> tuple[np.ndarray, list[Polygon]]:
    """Return vertices (V, 3) and polygons of a text OFF file, with or without normals, colours and comments.

    Raises ``ValueError`` for anything else; some collections write the counts right behind the keyword.
    """
    text = re.sub(r"#.*", "", data.decode("utf-8", "replace")).strip()
    keyword = re.match(r"(ST)?(C)?(N)?OFF", text)
    if keyword is None:
        raise ValueError("it does not begin with OFF")
    rows = [row.split() for row in text[keyword.end() :].splitlines() if row.strip()]
    if not rows or len(rows[0]) < 2:
        raise ValueError("the numbers of vertices and faces are missing")
    count, faces = int(rows[0][0]), int(rows[0][1])
    if min(count, faces) < 0 or len(rows) < 1 + count + faces:
        raise ValueError(f"it announces {count} vertices and {faces} faces and has {len(rows) - 1} lines")
    vertices = np.array([row[:3] for row in rows[1 : 1 + count]], dtype=np.float64).reshape(-1, 3)
    polygons = []
    for row in rows[1 + count : 1 + count + faces]:
        corners = [int(word) for word in row[1 : 1 + int(row[0])]]
        if len(corners) != int(row[0]):
            raise ValueError(f"a face is cut short: {' '.join(row)[:60]}")
        if len(corners) >= 3:
            polygons.append(corners)
    return vertices, polygons


def triangulate(vertices: np.ndarray, polygons: list[Polygon]) -> np.ndarray:
    """Cut polygons into triangles (F, 3) that keep their orientation and do not leave a concave outline.

    Polygons with a corner out of range become fans as they are, for the caller to report.
    """
    triangles: list[Polygon] = []
    for polygon in polygons:
        if len(polygon) == 3:
            triangles.append(polygon)
        else:
            triangles.extend(_cut(vertices, polygon))
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)


def _fan(polygon: Polygon) -> list[Polygon]:
    return [[polygon[0], a, b] for a, b in pairwise(polygon[1:])]


def _cut(vertices: np.ndarray, polygon: Polygon) -> list[Polygon]:
    if min(polygon) < 0 or max(polygon) >= len(vertices):
        return _fan(polygon)
    points = vertices[polygon] - vertices[polygon[0]]
    following = np.roll(points, -1, axis=0)
    normal = np.cross(points, following).sum(axis=0)  # Newell: twice the area vector
    length = np.linalg.norm(normal)
    if not 0 < length < np.inf:
        return _fan(polygon)
    turns = np.cross(points - np.roll(points, 1, axis=0), following - points) @ normal
    reflex = np.flatnonzero(turns < 0)
    if len(reflex) == 0:
        return _fan(polygon)
    if len(polygon) == 4:  # the cut of a concave quadrilateral begins at its inward corner
        return _fan(polygon[reflex[0] :] + polygon[: reflex[0]])
    return _ears(points, normal / length, polygon)


def _ears(points: np.ndarray, normal: np.ndarray, polygon: Polygon) -> list[Polygon]:
    """Cut a concave polygon in the plane of its area vector."""
    import manifold3d

    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    flat = points @ np.stack([across, np.cross(normal, across)], axis=1)
    cut = np.asarray(manifold3d.triangulate([flat]))
    if len(cut) != len(polygon) - 2:
        return _fan(polygon)
    return np.array(polygon)[cut].tolist()
