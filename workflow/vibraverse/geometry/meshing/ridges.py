"""Sharp edges of closed triangle surfaces: those that a remesher keeps, and those where stress concentrates."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vibraverse.geometry import surfaces

#: Grooves at which the normal turns inwards by more than this are rounded, not kept sharp.
_MAX_GROOVE_DEG = 150.0


def ridges(vertices: np.ndarray, faces: np.ndarray, angle_deg: float, shortest: float = 0.0) -> np.ndarray:
    """Return the edges (E, 2) at which the normal of a closed surface turns by more than ``angle_deg``.

    Edges that share points form a ridge. Ridges that extend less than ``shortest`` are left out: they are roughness
    that elements of that size cannot follow, and keeping it makes badly shaped elements. Narrow grooves are left out
    too, because chords along their bottom would cut their sides.
    """
    edges, turn, inwards = _edges(vertices, faces)
    groove = inwards & (turn > _MAX_GROOVE_DEG)
    return _extended(vertices, edges[(turn > angle_deg) & ~groove], shortest)


def reentrant_ridges(
    vertices: np.ndarray, faces: np.ndarray, angle_deg: float, shortest: float = 0.0
) -> np.ndarray:
    """Return the edges (E, 2) at which a closed surface bends inwards by more than ``angle_deg``.

    Narrow grooves are included. Ridges that extend less than ``shortest`` are left out.
    """
    edges, turn, inwards = _edges(vertices, faces)
    return _extended(vertices, edges[(turn > angle_deg) & inwards], shortest)


def _extended(vertices: np.ndarray, sharp: np.ndarray, shortest: float) -> np.ndarray:
    """Return the edges (E, 2) whose connected set extends at least ``shortest``."""
    if not len(sharp) or shortest <= 0:
        return sharp
    graph = coo_array((np.ones(len(sharp), np.int8), sharp.T), shape=(len(vertices),) * 2)
    ridge = connected_components(graph, directed=False)[1][sharp[:, 0]]
    low, high = np.full((ridge.max() + 1, 3), np.inf), np.full((ridge.max() + 1, 3), -np.inf)
    np.minimum.at(low, ridge, vertices[sharp].min(axis=1))
    np.maximum.at(high, ridge, vertices[sharp].max(axis=1))
    return sharp[np.linalg.norm(high - low, axis=1)[ridge] >= shortest]


def _edges(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the edges (E, 2) of a closed surface, by how many degrees its normal turns there, and whether inwards."""
    edges = surfaces.half_edges(faces)
    left, right = surfaces.neighbours(faces)
    normals, _ = surfaces.normals_and_areas(vertices, faces)
    cosine = np.einsum("ij,ij->i", normals[left // 3], normals[right // 3])
    # Where the surface bends inwards, the opposite corner of the right face lies above the left face.
    opposite = vertices[faces[right // 3, (right % 3 + 2) % 3]]
    above = np.einsum("ij,ij->i", opposite - vertices[edges[left, 0]], normals[left // 3])
    return edges[left], np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), above > 0
