"""Repairs of a triangle soup: weld, drop duplicates, orient, close, unite, wrap.

Every function takes and returns arrays and changes nothing beyond what its name says. The ladder in
:mod:`vibraverse.geometry.cleaning.ladder` decides which of them a mesh needs.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vibraverse.geometry import Mesh, surfaces

#: A triangle longer than this many times its height is a cap.
_CAP_ASPECT = 1e9
_TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], dtype=np.int32)


def weld(vertices: np.ndarray, faces: np.ndarray, tolerance: float = 0.0) -> Mesh:
    """Merge vertices that are equal, or connected by steps of at most ``tolerance``.

    Faces that then use a vertex twice are dropped, and so are unused vertices. Each cluster keeps its first vertex.
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
    """Return the faces without duplicates: the first of those over the same three vertices stays."""
    first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1]
    return faces[np.sort(first)]


def orient(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Flip faces so that neighbours agree and every connected part encloses a positive volume.

    Neighbours share an edge that has exactly two faces. Each part is first oriented the way that flips fewer
    faces. A part that cannot be oriented (a Möbius band) is left unchanged.
    """
    n = len(faces)
    edges = surfaces.half_edges(faces)
    left, right = surfaces.neighbours(faces)
    agree = edges[left, 0] == edges[right, 1]
    i, j = left // 3, right // 3
    # Two nodes per face, unchanged and flipped; a link joins the states in which neighbours agree.
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
    """Return the parts of a surface, connected through edges of exactly two faces, each with its own vertices.

    Bodies that share only points, or an edge of four faces, are separate parts.
    """
    label = part_numbers(faces)
    return [surfaces.compact(vertices, faces[label == i]) for i in range(int(label.max(initial=-1)) + 1)]


def part_numbers(faces: np.ndarray) -> np.ndarray:
    """Return the number of the part (F,) that each face belongs to, as :func:`parts` tells them apart."""
    left, right = surfaces.neighbours(faces)
    graph = coo_array((np.ones(len(left), np.int8), (left // 3, right // 3)), shape=(len(faces),) * 2)
    return connected_components(graph, directed=False)[1]


def _meshlab(vertices: np.ndarray, faces: np.ndarray):
    import pymeshlab

    session = pymeshlab.MeshSet(verbose=False)
    session.add_mesh(pymeshlab.Mesh(vertices, np.ascontiguousarray(faces, dtype=np.int32)))
    return session


def _arrays(session) -> Mesh:
    mesh = session.current_mesh()
    return mesh.vertex_matrix().astype(np.float64), mesh.face_matrix().astype(np.int64)


def close_holes(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Close every hole by triangles over its rim, after dropping faces at edges with more than two.

    Covers may cut other faces. Vertices where holes meet are split only if the surface does not close otherwise.
    """
    for split in (False, True):
        session = _meshlab(vertices, faces)
        session.meshing_repair_non_manifold_edges()
        if split:
            session.meshing_repair_non_manifold_vertices()
        session.meshing_close_holes(maxholesize=len(faces) + 3, selfintersection=False)
        closed = _arrays(session)
        if surfaces.topology(closed[1], len(closed[0])).closed_manifold:
            break
    return closed


def flip_caps(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Flip the longest edge of every cap, so that its third vertex splits the neighbour there.

    The surface must be manifold.
    """
    session = _meshlab(vertices, faces)
    session.meshing_remove_t_vertices(method="Edge Flip", threshold=_CAP_ASPECT, repeat=True)
    return _arrays(session)


def unite(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """Return the outer surface of the union of closed, outward surfaces, which may cut each other and themselves.

    The arrangement of all triangles is exact; a positive winding number means inside (Zhou et al., ACM Trans. Graph.
    35(4), 2016). The result touches itself in an edge or a point where the bodies do. Raises ``ValueError`` when the
    surfaces are not closed.
    """
    import pymeshlab

    session = _meshlab(vertices, faces)
    # A difference resolves the first mesh whatever the second is, so a tetrahedron far away is taken off.
    far = vertices.max(axis=0) + np.ptp(vertices, axis=0).max()
    session.add_mesh(pymeshlab.Mesh(far + np.eye(4, 3, k=-1), _TETRAHEDRON))
    try:
        session.generate_boolean_difference(first_mesh=0, second_mesh=1)
    except pymeshlab.PyMeshLabException as error:
        raise ValueError(str(error)) from None
    return _arrays(session)


def join(bodies: list[Mesh]) -> Mesh:
    """Return the surface of the union of closed bodies without self-intersections, much faster than :func:`unite`.

    Raises ``ValueError`` when a body is not a valid solid.
    """
    import manifold3d

    return _mesh(manifold3d.Manifold.batch_boolean([_solid(*body) for body in bodies], manifold3d.OpType.Add))


def separate(vertices: np.ndarray, faces: np.ndarray, distance: float) -> Mesh:
    """Separate a closed, oriented surface where it touches itself in edges or points.

    Faces around an edge are paired across the solid between them. Each fan of faces gets its own copy of a vertex,
    which moves into the fan by ``distance``, or by less where the faces are small.
    """
    fan, source = surfaces.fans(faces, _paired(vertices, faces, *surfaces.edge_numbers(faces)))
    split = np.bincount(source, minlength=len(vertices))[source] > 1
    points, faces = vertices[source], fan.reshape(-1, 3)
    if split.any():
        ends = surfaces.half_edges(faces)
        towards, around = np.zeros_like(points), np.zeros(len(points))
        np.add.at(towards, ends[:, 0], points[ends[:, 1]] - points[ends[:, 0]])
        np.add.at(around, ends[:, 0], 1.0)
        step = towards / np.maximum(around, 1.0)[:, None]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step *= np.minimum(0.05, distance / np.maximum(length, 1e-300))
        points = np.where(split[:, None], points + step, points)
    return points, faces


def _paired(vertices: np.ndarray, faces: np.ndarray, edge: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Return the edge numbers (3F,), with each edge of more than two faces split into pairs of faces.

    The solid lies to the left of a face. So, seen along the edge, a face that runs up it and the next one
    counter-clockwise that runs down it bound a wedge of the solid.
    """
    halves, edge = surfaces.half_edges(faces), edge.copy()
    number = len(count)
    for crowded in np.flatnonzero(count > 2):
        around = np.flatnonzero(edge == crowded)
        low, high = np.sort(halves[around[0]])
        along = vertices[high] - vertices[low]
        third = faces.ravel()[around - around % 3 + (around + 2) % 3]
        out = vertices[third] - vertices[low]
        basis = np.linalg.svd(along[None])[2]
        basis[0] = along
        if np.linalg.det(basis) < 0:
            basis[2] = -basis[2]
        angle = np.arctan2(out @ basis[2], out @ basis[1])
        up = halves[around, 0] == low
        order = around[np.argsort(angle, kind="stable")]
        turned = up[np.argsort(angle, kind="stable")]
        starts = np.flatnonzero(turned)
        for start in starts:
            # Outward normals: the solid is clockwise of a face that runs up the edge.
            before = order[start - 1]
            if turned[start - 1]:
                break
            edge[[order[start], before]] = number
            number += 1
    return edge


def wrap(vertices: np.ndarray, faces: np.ndarray, alpha: float, offset: float) -> Mesh:
    """Return the alpha wrap of a soup: a closed surface ``offset`` outside it that enters no gap below ``alpha``.

    Both lengths are shares of the bounding box's diagonal. (Portaneri et al., ACM Trans. Graph. 41(4), 2022.)
    """
    import pymeshlab

    # A soup of single triangles, because MeshLab drops faces at edges with more than two.
    session = _meshlab(vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))
    session.generate_alpha_wrap(
        alpha=pymeshlab.PercentageValue(100 * alpha), offset=pymeshlab.PercentageValue(100 * offset)
    )
    return _arrays(session)


def split(vertices: np.ndarray, faces: np.ndarray, longest: float) -> Mesh:
    """Halve edges until none is longer than ``longest``; the shape and the given vertices do not change."""
    import pymeshlab

    length = float(surfaces.edge_lengths(vertices, faces).max(initial=0.0))
    if length <= longest:
        return vertices, faces
    session = _meshlab(vertices, faces)
    session.meshing_surface_subdivision_midpoint(
        iterations=int(np.ceil(np.log2(length / longest))), threshold=pymeshlab.PureValue(longest)
    )
    return _arrays(session)


def simplify(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> Mesh:
    """Simplify a closed surface, moving it by less than ``tolerance``."""
    return _mesh(_solid(vertices, faces).simplify(tolerance))


def _solid(vertices: np.ndarray, faces: np.ndarray):
    """Return a closed surface as a manifold3d solid; raises ``ValueError`` when it is not closed."""
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
