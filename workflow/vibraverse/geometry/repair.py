"""Gentle repairs of a triangle soup: weld, drop what is degenerate or doubled, orient, patch, close, join, wrap.

Every function takes and returns arrays and changes as little as its name says. The ladder that decides which
of them a mesh needs is in :mod:`vibraverse.geometry.clean`.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vibraverse.geometry import surfaces
from vibraverse.geometry.crossing import crossing_faces as crossing_faces

Mesh = tuple[np.ndarray, np.ndarray]


def weld(vertices: np.ndarray, faces: np.ndarray, tolerance: float = 0.0) -> Mesh:
    """Merge vertices that are equal, or connected by steps of at most ``tolerance``.

    Faces that thereby use a vertex twice go, and so do unused vertices. Each cluster keeps its first vertex.
    """
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    group = np.argsort(np.argsort(first))[inverse.ravel()]
    vertices, faces = vertices[np.sort(first)], group[faces]
    if tolerance > 0:
        from scipy.spatial import cKDTree

        pairs = cKDTree(vertices).query_pairs(tolerance, output_type="ndarray")
        graph = coo_array((np.ones(len(pairs), np.int8), pairs.T), shape=(len(vertices),) * 2)
        labels = connected_components(graph, directed=False)[1]
        keep = np.unique(labels, return_index=True)[1]
        vertices, faces = vertices[keep], labels[faces]
    a, b, c = faces.T
    return surfaces.compact(vertices, faces[(a != b) & (b != c) & (c != a)])


def drop_doubles(faces: np.ndarray) -> np.ndarray:
    """Keep one of every set of faces over the same three vertices."""
    first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    return faces[np.sort(first)]


def orient(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Turn faces so that neighbours agree and every connected part encloses a positive volume.

    Neighbours share an edge that has exactly two faces. Of the two ways to orient a part the one that turns
    fewer faces is taken first; a part that cannot be oriented (a Möbius band) stays as it is.
    """
    n = len(faces)
    edges = surfaces.half_edges(faces)
    left, right = _neighbours(faces)
    agree = edges[left, 0] == edges[right, 1]
    i, j = left // 3, right // 3
    # Two nodes per face, as it is and turned; an edge joins the states in which its faces agree.
    rows = np.concatenate([i, i + n])
    columns = np.concatenate([np.where(agree, j, j + n), np.where(agree, j + n, j)])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * n, 2 * n))
    n_labels, labels = connected_components(graph, directed=False)
    votes = np.bincount(labels[:n], minlength=n_labels)
    turned = votes[labels[n:]] > votes[labels[:n]]
    tie = (votes[labels[n:]] == votes[labels[:n]]) & (labels[n:] < labels[:n])
    faces = np.where((turned | tie)[:, None], faces[:, ::-1], faces)
    part = np.minimum(labels[:n], labels[n:])
    a, b, c = surfaces.corners(vertices, faces)
    signed = np.bincount(part, np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=n_labels)
    return np.where((signed[part] < 0)[:, None], faces[:, ::-1], faces)


def parts(vertices: np.ndarray, faces: np.ndarray) -> list[Mesh]:
    """Return the parts whose faces are joined through edges of exactly two faces, each with its own vertices.

    Bodies that share only points, or an edge at which four faces meet, are parts of their own.
    """
    left, right = _neighbours(faces)
    graph = coo_array((np.ones(len(left), np.int8), (left // 3, right // 3)), shape=(len(faces),) * 2)
    n, label = connected_components(graph, directed=False)
    return [surfaces.compact(vertices, faces[label == i]) for i in range(n)]


def _neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the half-edges that meet in the edges of exactly two faces, as two arrays."""
    keys = surfaces.edge_keys(surfaces.half_edges(faces))
    order = np.argsort(keys, kind="stable")
    start = np.flatnonzero(np.r_[True, np.diff(keys[order]) != 0])
    start = start[np.diff(np.r_[start, len(keys)]) == 2]
    return order[start], order[start + 1]


def _meshlab(vertices: np.ndarray, faces: np.ndarray):
    import pymeshlab

    session = pymeshlab.MeshSet(verbose=False)
    session.add_mesh(pymeshlab.Mesh(vertices, np.ascontiguousarray(faces, dtype=np.int32)))
    return session


def _arrays(session) -> Mesh:
    mesh = session.current_mesh()
    return mesh.vertex_matrix().astype(np.float64), mesh.face_matrix().astype(np.int64)


def close_holes(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Close every hole by triangles over its rim; faces at edges with more than two go first."""
    session = _meshlab(vertices, faces)
    session.meshing_repair_non_manifold_edges()
    session.meshing_repair_non_manifold_vertices()
    session.meshing_close_holes(maxholesize=len(faces) + 3, selfintersection=False)
    return _arrays(session)


def patch(vertices: np.ndarray, faces: np.ndarray, rounds: int = 5) -> Mesh:
    """Cut out the faces that cut each other, with a growing rim, and close the holes that leaves."""
    for ring in range(rounds):
        session = _meshlab(vertices, faces)
        session.compute_selection_by_self_intersections_per_face()
        crossing = session.current_mesh().selected_face_number()
        if not crossing and surfaces.topology(faces, len(vertices)).closed_manifold:
            break
        for _ in range(ring):
            session.apply_selection_dilatation()
        session.meshing_remove_selected_faces()
        session.meshing_repair_non_manifold_edges()
        session.meshing_repair_non_manifold_vertices()
        session.meshing_remove_unreferenced_vertices()
        session.meshing_close_holes(maxholesize=200, selfintersection=True)
        vertices, faces = _arrays(session)
    return surfaces.compact(vertices, faces)


def join(bodies: list[Mesh], tolerance: float) -> list[Mesh]:
    """Return the union of closed bodies as its disjoint pieces, the largest first.

    Details below ``tolerance`` that cutting leaves are smoothed away. Raises ``ValueError`` when a body is not
    a valid solid.
    """
    import manifold3d

    union = manifold3d.Manifold.batch_boolean([_solid(*body) for body in bodies], manifold3d.OpType.Add)
    pieces = sorted(union.decompose(), key=lambda piece: -piece.volume())
    return [_mesh(piece.simplify(tolerance)) for piece in pieces]


def wrap(vertices: np.ndarray, faces: np.ndarray, alpha: float, offset: float) -> Mesh:
    """Shrink-wrap a soup: a closed surface ``offset`` outside it that enters no gap narrower than ``alpha``.

    Both are shares of the bounding box's diagonal. (Alpha wrapping, Portaneri et al., ACM Trans. Graph. 41(4), 2022.)
    """
    import pymeshlab

    session = _meshlab(vertices, faces)
    session.generate_alpha_wrap(
        alpha=pymeshlab.PercentageValue(100 * alpha), offset=pymeshlab.PercentageValue(100 * offset)
    )
    return _arrays(session)


def simplify(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> Mesh:
    """Thin a closed surface where that moves it by less than ``tolerance``."""
    return _mesh(_solid(vertices, faces).simplify(tolerance))


def _solid(vertices: np.ndarray, faces: np.ndarray):
    """Return a closed surface as manifold3d holds it; raises ``ValueError`` when it is not one."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.uint64))
    )
    if solid.status() != manifold3d.Error.NoError:
        raise ValueError(solid.status().name)
    return solid


def _mesh(solid) -> Mesh:
    mesh = solid.to_mesh64()
    return np.array(mesh.vert_properties[:, :3], dtype=np.float64), np.array(mesh.tri_verts, dtype=np.int64)
