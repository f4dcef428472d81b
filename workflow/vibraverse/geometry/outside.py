"""The outside of a body, as a page shows it: without cavities, and with few enough vertices."""

from __future__ import annotations

import numpy as np
import scipy.spatial

from vibraverse.geometry import surfaces


def outer(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the faces (F', 3) of the parts that bound the body from outside; cavities enclose a negative volume."""
    part = surfaces.face_components(faces, len(vertices))
    volumes = [surfaces.volume(vertices, faces[part == number]) for number in range(part.max() + 1)]
    return faces[np.asarray(volumes)[part] > 0]


def decimate(vertices: np.ndarray, faces: np.ndarray, most: int) -> np.ndarray:
    """Return faces (F', 3) among the same vertices that use at most about ``most`` of them.

    Edges are collapsed onto one of their ends (Garland and Heckbert, SIGGRAPH 1997, in MeshLab), so what is known at
    the vertices stays known.
    """
    used, places = np.unique(faces, return_inverse=True)
    if len(used) <= most:
        return faces
    import pymeshlab

    session = pymeshlab.MeshSet(verbose=False)
    session.add_mesh(pymeshlab.Mesh(vertices[used], places.reshape(faces.shape).astype(np.int32)))
    session.meshing_decimation_quadric_edge_collapse(
        targetfacenum=round(len(faces) * most / len(used)), optimalplacement=False, preservetopology=True
    )
    kept = session.current_mesh()
    _, found = scipy.spatial.cKDTree(vertices[used]).query(kept.vertex_matrix())
    return used[found[kept.face_matrix()]]
