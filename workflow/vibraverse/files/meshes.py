"""Reading of mesh files in every format of :mod:`vibraverse.files.formats`, and writing as PLY.

Reading neither merges nor reorders nor drops vertices. Polygons become triangles, and a scene becomes one mesh with its
parts transformed into place. Whatever the bytes, the result is a mesh or a refusal that names the mistake, in bounded
memory.
"""

from __future__ import annotations

import io
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import said
from vibraverse.files.formats import MeshData, known, names, of_file
from vibraverse.files.opening import open_regular
from vibraverse.files.reading.bounds import Bounds, TooLarge
from vibraverse.files.reading.mistakes import Unsupported

_EXPORT_AGAIN = "Export it again from the program that made it."
_EXPORT_WHOLE = "Export it again, completely: the file seems cut off."
_CHECK_NAME = "Check that the file is whole and that its extension tells its format, then export it again."

#: Default limit, far above what any stage can use; stages pass their own.
_MAX_TRIANGLES = 100_000_000


def read_mesh(
    path: str | Path, format: str | None = None, name: str | None = None, max_triangles: int = _MAX_TRIANGLES
) -> MeshData:
    """Return the mesh in a file.

    ``format`` is the key of a format (default: by the extension); ``name`` is the name of the file in refusals
    (default: its own). A file that has, or announces, more than ``max_triangles`` is refused before memory is
    allocated for them. Raises :class:`Refused` with reason ``unreadable``, ``empty``, ``not_finite`` or ``too_large``,
    or ``MemoryError``; nothing else, whatever the bytes.
    """
    path = Path(path)
    name = name or path.name
    found = known().get(format.lower().lstrip(".")) if format else of_file(path)
    if found is None:
        raise Refused(
            "unreadable",
            f"{name} is not in a format that can be read ({format or path.suffix or 'no extension'}).",
            f"Convert it to one of {names()}.",
        )
    with open_regular(path, name) as file, warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        if not file.read(1):
            raise Refused("empty", f"{name} is empty (0 bytes).", _EXPORT_AGAIN)
        file.seek(0)
        try:
            data = io.BytesIO(found.pack(file.read(), path.parent)) if found.pack else file
            mesh = found.read(data, Bounds(max_triangles))
        except TooLarge as error:
            raise Refused(
                "too_large", f"{name} {said(error)}.", "Simplify the mesh, or raise clean.max_triangles."
            ) from None
        except (ValueError, OSError) as error:
            advice = error.advice if isinstance(error, Unsupported) else _CHECK_NAME
            raise Refused(
                "unreadable", f"{name} could not be read as {found.name}: {said(error)}.", advice
            ) from None
        return _checked(mesh, name)


def _checked(mesh: MeshData, name: str) -> MeshData:
    """Return the mesh in its final types; raises :class:`Refused` if it is not valid."""
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    if len(vertices) == 0:
        without = f" ({'; '.join(mesh.notes)})" if mesh.notes else ""
        raise Refused("empty", f"{name} holds no vertices{without}.", _EXPORT_AGAIN)
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
            _EXPORT_WHOLE,
        )
    bad = int((~np.isfinite(vertices)).any(axis=1).sum())
    if bad:
        raise Refused(
            "not_finite",
            f"{name} has {bad} of {len(vertices)} vertices with a coordinate that is not a finite number.",
            "Remove those vertices, or export it again.",
        )
    return replace(mesh, vertices=vertices, faces=faces)


_PLY_HEADER = (
    "ply\nformat binary_little_endian 1.0\n"
    "element vertex {vertices}\nproperty double x\nproperty double y\nproperty double z\n"
    "element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
)


def write_ply(path: str | Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Write ``vertices`` (V, 3) and ``faces`` (F, 3) as a binary PLY of doubles, reproducible byte for byte."""
    Path(path).write_bytes(ply_bytes(vertices, faces))


def ply_bytes(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """Return the bytes that :func:`write_ply` writes."""
    rows = np.zeros(len(faces), dtype=[("count", "u1"), ("corners", "<i4", (3,))])
    rows["count"], rows["corners"] = 3, faces
    header = _PLY_HEADER.format(vertices=len(vertices), faces=len(faces)).encode()
    return header + np.ascontiguousarray(vertices, dtype="<f8").tobytes() + rows.tobytes()


def read_ply(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) float64 and faces (F, 3) int64 of a PLY, exactly as :func:`write_ply` wrote them."""
    mesh = read_mesh(path, "ply")
    return mesh.vertices, mesh.faces
