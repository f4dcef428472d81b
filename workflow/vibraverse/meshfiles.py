"""Mesh files to arrays and back: OBJ, STL, PLY, OFF, GLB/glTF and 3MF.

Reading keeps what the file says: vertices are neither merged nor reordered nor dropped, polygons become
triangles, and a scene of several parts becomes one mesh with each part where its transforms put it. Whatever
the bytes, the result is a mesh or a refusal that says what is wrong with the file.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vibraverse.refusal import Refused
from vibraverse.sources import threemf
from vibraverse.sources.files import FORMATS
from vibraverse.sources.gltf import pack, required_extensions
from vibraverse.sources.polygons import parse_obj, parse_off, triangulate

_EXPORT_AGAIN = "Export it again from the program that made it."
_CHECK_NAME = "Check that the file is whole and that its extension tells its format, then export it again."


@dataclass(frozen=True)
class MeshData:
    """Triangles as a file states them.

    ``vertices`` (V, 3) float64 in the file's units, ``faces`` (F, 3) int64, ``unit_m`` metres per unit where
    the format states it (glTF is in metres, 3MF names its unit) and None elsewhere, ``parts`` how many meshes
    were joined.
    """

    vertices: np.ndarray
    faces: np.ndarray
    unit_m: float | None = None
    parts: int = 1


def read_mesh(path: str | Path, format: str | None = None, name: str | None = None) -> MeshData:
    """Read a mesh file.

    ``format`` is a value of :data:`FORMATS` (default: by the extension); ``name`` is what to call the file in
    a refusal (default: its own name). Raises :class:`Refused` with reason ``unreadable``, ``empty`` or
    ``not_finite``, and nothing else whatever the bytes are.
    """
    path = Path(path)
    name = name or path.name
    format = (format or FORMATS.get(path.suffix.lower(), path.suffix)).lower().lstrip(".")
    if format not in FORMATS.values():
        raise Refused(
            "unreadable",
            f"{name} is not in a format that can be read ({format or 'no extension'}).",
            f"Convert it to one of {', '.join(dict.fromkeys(FORMATS.values())).upper()}.",
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise Refused(
            "unreadable", f"{name} cannot be opened ({error.strerror}).", "Check the file's permissions."
        ) from None
    if not data:
        raise Refused("empty", f"{name} is empty (0 bytes).", _EXPORT_AGAIN)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            mesh = _PARSERS[format](data, path)
            return _checked(mesh, name)
    except Refused:
        raise
    except MemoryError:
        raise Refused(
            "unreadable", f"{name} needs more memory than there is.", "Simplify the mesh."
        ) from None
    except Exception as error:
        what = " ".join(str(error).split())[:200] or type(error).__name__
        raise Refused(
            "unreadable",
            f"{name} could not be read as {format.upper()}: {what}.",
            _CHECK_NAME,
        ) from None


def _checked(mesh: MeshData, name: str) -> MeshData:
    """Return the mesh in its final types, or raise what is wrong with it."""
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if len(vertices) == 0:
        raise Refused("empty", f"{name} holds no vertices.", _EXPORT_AGAIN)
    if len(faces) == 0:
        raise Refused(
            "empty",
            f"{name} holds {len(vertices)} points and no triangles.",
            "A surface is needed: reconstruct one from the points, or export the mesh with its faces.",
        )
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= len(vertices):
        wrong = low if low < 0 else high
        raise Refused(
            "unreadable",
            f"{name} has a triangle at vertex {wrong}, but its vertices are 0 to {len(vertices) - 1}.",
            f"The file seems cut off. {_EXPORT_AGAIN}",
        )
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise Refused(
            "not_finite",
            f"{name} has {bad} of {len(vertices)} vertices with a coordinate that is not a finite number.",
            "Remove those vertices, or export it again.",
        )
    return MeshData(vertices, faces, mesh.unit_m, mesh.parts)


def _read_obj(data: bytes, path: Path) -> MeshData:
    vertices, polygons = parse_obj(data)
    return MeshData(vertices, triangulate(vertices, polygons))


def _read_stl(data: bytes, path: Path) -> MeshData:
    mesh = _trimesh(data, "stl")
    if len(mesh.faces) == 0 and not data.lstrip().startswith(b"solid"):
        raise ValueError("it is neither a text nor a binary STL file")
    return mesh


def _read_ply(data: bytes, path: Path) -> MeshData:
    return _trimesh(data, "ply", skip_materials=True, fix_texture=False)


def _read_off(data: bytes, path: Path) -> MeshData:
    vertices, polygons = parse_off(data)
    return MeshData(vertices, triangulate(vertices, polygons))


def _read_glb(data: bytes, path: Path) -> MeshData:
    for extension in required_extensions(data):
        if "compression" in extension:
            raise ValueError(f"it is compressed with {extension}, which is not supported")
    return _trimesh(data, "glb", skip_materials=True, unit_m=1.0)


def _read_gltf(data: bytes, path: Path) -> MeshData:
    return _read_glb(pack(data, path.parent), path)


def _read_3mf(data: bytes, path: Path) -> MeshData:
    vertices, faces, unit_m, parts = threemf.parse(data)
    return MeshData(vertices, faces, unit_m, parts)


def _trimesh(data: bytes, format: str, unit_m: float | None = None, **options) -> MeshData:
    """Parse with trimesh, without any of its processing, and join the parts of a scene."""
    import trimesh

    scene = trimesh.load_scene(io.BytesIO(data), file_type=format, process=False, **options)
    vertices, faces, offset = [], [], 0
    for node in scene.graph.nodes_geometry:
        transform, geometry = scene.graph[node]
        part = scene.geometry[geometry]
        points = np.asarray(part.vertices, dtype=np.float64)
        triangles = np.asarray(getattr(part, "faces", np.zeros((0, 3))), dtype=np.int64)
        if not np.array_equal(transform, np.eye(4)):
            points = points @ transform[:3, :3].T + transform[:3, 3]
            if np.linalg.det(transform[:3, :3]) < 0:  # a mirrored part keeps its outside outside
                triangles = triangles[:, ::-1]
        # An index out of range must stay so when parts are joined.
        if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
            return MeshData(points, triangles)
        vertices.append(points)
        faces.append(triangles + offset)
        offset += len(points)
    if not vertices:
        return MeshData(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    return MeshData(np.concatenate(vertices), np.concatenate(faces), unit_m, len(vertices))


_PARSERS = {
    "obj": _read_obj,
    "stl": _read_stl,
    "ply": _read_ply,
    "off": _read_off,
    "glb": _read_glb,
    "gltf": _read_gltf,
    "3mf": _read_3mf,
}

_PLY_HEADER = (
    "ply\nformat binary_little_endian 1.0\n"
    "element vertex {vertices}\nproperty double x\nproperty double y\nproperty double z\n"
    "element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
)


def write_ply(path: str | Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write ``vertices`` (V, 3) and ``faces`` (F, 3) as a binary PLY of doubles; same arrays, same bytes."""
    Path(path).write_bytes(ply_bytes(vertices, faces))


def ply_bytes(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """Return what :func:`write_ply` writes."""
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    rows["count"], rows["corners"] = 3, faces
    header = _PLY_HEADER.format(vertices=len(vertices), faces=len(faces)).encode()
    return header + np.ascontiguousarray(vertices, dtype="<f8").tobytes() + rows.tobytes()


def read_ply(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) float64 and faces (F, 3) int64 of a PLY, exactly as :func:`write_ply` wrote."""
    mesh = read_mesh(path, "ply")
    return mesh.vertices, mesh.faces
