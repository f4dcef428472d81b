"""Triangle surfaces as arrays: their measures, their edges, their connected parts.

A surface is ``vertices`` (V, 3) float64 and ``faces`` (F, 3) integers, counter-clockwise seen from outside the
body. By the divergence theorem, the enclosed volume is the sum of the signed volumes of the tetrahedra between
the origin and the faces: ``V = 1/6 Σ a·(b × c)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vibraverse.geometry import Mesh


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the volume enclosed by a closed, oriented surface; negative when it is inside out."""
    if not len(faces):
        return 0.0
    a, b, c = corners(vertices - vertices[faces[0, 0]], faces)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def corners(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the three corner points of every face, each (F, 3)."""
    return vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]]


def normals_and_areas(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return unit normals (F, 3) and areas (F,); a face without area has a zero normal."""
    a, b, c = corners(vertices, faces)
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.where(length > 0, length, 1.0)[:, None], 0.5 * length


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return unit normals at the vertices (V, 3): means over the faces around, weighted by area."""
    normals, areas = normals_and_areas(vertices, faces)
    total = np.zeros((len(vertices), 3))
    np.add.at(total, faces.ravel(), np.repeat(normals * areas[:, None], 3, axis=0))
    return total / np.maximum(np.linalg.norm(total, axis=1), 1e-300)[:, None]


def steps_to_heights(
    vertices: np.ndarray, faces: np.ndarray, heights: np.ndarray | float, stiffness: float
) -> np.ndarray:
    """Return the displacements ``u`` of the vertices (V, 3) that lift every face by its height ``h_f``.

    Least squares: each ``u`` minimises ``Σ_f A_f (n_f·u - h_f)² + ε Σ_f A_f |u|²`` over the faces around its vertex.
    ``heights`` is one length or one per face (F,); the ``stiffness`` ε keeps a vertex from sliding along its surface.
    """
    normals, areas = normals_and_areas(vertices, faces)
    corner = faces.ravel()
    matrix, vector = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3))
    outer = (areas[:, None] * normals)[:, :, None] * normals[:, None, :]
    np.add.at(matrix, corner, np.repeat(outer, 3, axis=0))
    np.add.at(vector, corner, np.repeat((areas * heights)[:, None] * normals, 3, axis=0))
    weight = np.trace(matrix, axis1=1, axis2=2)
    matrix += (stiffness * weight + (weight == 0))[:, None, None] * np.eye(3)
    return np.linalg.solve(matrix, vector[:, :, None])[:, :, 0]


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the total area."""
    return float(normals_and_areas(vertices, faces)[1].sum())


def half_edges(faces: np.ndarray) -> np.ndarray:
    """Return the directed edges (3F, 2): the three of face 0, of face 1, …"""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def edge_keys(edges: np.ndarray) -> np.ndarray:
    """Return one integer per edge (E,), the same for both directions."""
    low, high = edges.min(axis=1).astype(np.int64), edges.max(axis=1).astype(np.int64)
    return low * (int(high.max(initial=0)) + 1) + high


def edge_numbers(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of each half-edge's undirected edge (3F,), and the number of faces of each edge (E,)."""
    _, number, count = np.unique(edge_keys(half_edges(faces)), return_inverse=True, return_counts=True)
    return number, count


def neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs of half-edges at edges of exactly two faces, as two arrays of their numbers (E,)."""
    keys = edge_keys(half_edges(faces))
    order = np.argsort(keys, kind="stable")
    start = np.flatnonzero(np.r_[True, np.diff(keys[order]) != 0])
    start = start[np.diff(np.r_[start, len(keys)]) == 2]
    return order[start], order[start + 1]


def edge_lengths(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the lengths of the edges of every face, (F, 3)."""
    edges = half_edges(faces)
    return np.linalg.norm(vertices[edges[:, 1]] - vertices[edges[:, 0]], axis=1).reshape(-1, 3)


def face_components(faces: np.ndarray, n_vertices: int) -> np.ndarray:
    """Return the number of each face's connected part (F,). Parts are numbered in the order of their first face.

    Faces are connected when they share a vertex.
    """
    if not len(faces):
        return np.zeros(0, dtype=np.int64)
    rows, columns = np.repeat(faces[:, 0], 2), faces[:, 1:].ravel()
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(n_vertices, n_vertices))
    labels = connected_components(graph, directed=False)[1][faces[:, 0]]
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[inverse]


def components(vertices: np.ndarray, faces: np.ndarray) -> list[Mesh]:
    """Return the parts of a surface that share no point."""
    part = face_components(faces, len(vertices))
    return [compact(vertices, faces[part == i]) for i in range(int(part.max(initial=-1)) + 1)]


def compact(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Drop the vertices that no face uses, keeping the order of the others."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def joined(meshes: list[Mesh]) -> Mesh:
    """Return several meshes as one, in their order."""
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return (
        np.concatenate([vertices for vertices, _ in meshes]),
        np.concatenate([faces + offset for (_, faces), offset in zip(meshes, offsets[:-1], strict=True)]),
    )


@dataclass(frozen=True)
class Topology:
    """Counts of the defects of a triangle mesh, with its components and Euler characteristic."""

    open_edges: int
    """Edges with one face."""
    crowded_edges: int
    """Edges with more than two faces."""
    disagreeing_edges: int
    """Edges whose two faces are oriented against each other."""
    pinched_vertices: int
    """Vertices whose faces do not form one fan."""
    degenerate_faces: int
    """Faces that use a vertex twice."""
    components: int
    """Connected parts."""
    euler: int
    """V - E + F over the used vertices."""

    @property
    def closed_manifold(self) -> bool:
        """Whether the surface is closed, consistently oriented and manifold in its edges and vertices."""
        return not (
            self.open_edges
            or self.crowded_edges
            or self.disagreeing_edges
            or self.pinched_vertices
            or self.degenerate_faces
        )

    @property
    def genus(self) -> int:
        """Number of handles of a closed manifold surface."""
        return self.components - self.euler // 2


def topology(faces: np.ndarray, n_vertices: int) -> Topology:
    """Count the defects of a set of triangles."""
    if not len(faces):
        return Topology(0, 0, 0, 0, 0, 0, 0)
    edges = half_edges(faces)
    edge, counts = edge_numbers(faces)
    turned = np.bincount(edge, weights=np.where(edges[:, 0] < edges[:, 1], 1.0, -1.0))
    degenerate = (
        (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    ).sum()
    used = len(np.unique(faces))
    return Topology(
        open_edges=int((counts == 1).sum()),
        crowded_edges=int((counts > 2).sum()),
        disagreeing_edges=int(((counts == 2) & (turned != 0)).sum()),
        pinched_vertices=len(fans(faces, edge)[1]) - used,
        degenerate_faces=int(degenerate),
        components=int(face_components(faces, n_vertices).max()) + 1,
        euler=used - len(counts) + len(faces),
    )


def fans(faces: np.ndarray, edge_of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the fan of every face corner (3F,), in the order of ``faces.ravel()``, and the vertex of every fan (N,).

    A fan is a set of corners at one vertex, joined through shared edges; a manifold surface has one per vertex.
    ``edge_of`` (3F,) numbers the edge of every half-edge, as :func:`edge_numbers` does.
    """
    n = 3 * len(faces)
    corner = np.arange(n)
    after = corner - corner % 3 + (corner + 1) % 3
    # Corners that meet along an edge: each of its two faces has a corner at either end.
    order = np.lexsort((corner, edge_of))
    same = edge_of[order][1:] == edge_of[order][:-1]
    first, second = order[:-1][same], order[1:][same]
    ends = faces.ravel()
    aligned = ends[first] == ends[second]
    left = np.concatenate([first, after[first]])
    right = np.concatenate(
        [np.where(aligned, second, after[second]), np.where(aligned, after[second], second)]
    )
    graph = coo_array((np.ones(len(left), np.int8), (left, right)), shape=(n, n))
    number, label = connected_components(graph, directed=False)
    vertex = np.empty(number, dtype=np.int64)
    vertex[label] = ends
    return label.astype(np.int64), vertex
