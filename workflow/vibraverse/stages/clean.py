"""Stage ``clean``: the source mesh in, the closed, oriented, manifold surface of one solid body out."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, NamedTuple

from vibraverse.contract.stage import Job

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from vibraverse.config.geometry import Clean
    from vibraverse.geometry.cleaning.clean import CleanSurface


def run(job: Job) -> None:
    """Read and repair the source mesh in a child process, and write the surface and a record of the repairs."""
    from vibraverse.contract import products
    from vibraverse.contract.limits import run_limited
    from vibraverse.files import meshes
    from vibraverse.geometry import surfaces
    from vibraverse.geometry.cleaning.clean import clean

    source = products.read_json(job.inputs["source_record"])
    limits = job.options.limits
    body, mesh = run_limited(
        _read_and_clean,
        clean,  # imported before the fork, so that its libraries do not count against the child's memory limit
        job.inputs["mesh"],
        source["format"],
        source.get("file"),
        job.options,
        seconds=limits.seconds,
        memory_mb=limits.memory_mb,
        key="clean.limits",
        what="Reading and repairing the mesh",
    )
    meshes.write_ply(job.outputs["surface"], body.vertices, body.faces)
    unit_m = source.get("unit_m")
    size_m = source.get("size_m")
    if size_m is None and unit_m is not None:
        size_m = unit_m * body.longest_side
    job.write_record(
        {
            "object": job.object,
            "rung": body.rung,
            "ladder": body.ladder,
            "repairs": [*mesh.notes, *body.repairs],
            "warnings": list(mesh.warnings),
            "dropped": {"parts": body.dropped_parts, "volume_share": body.dropped_share},
            "left_out": {"parts": body.left_out_parts, "area_share": body.left_out_share},
            "joined": {"bodies": body.joined_bodies, "volume_growth": body.joined_growth},
            "filled_cavities": body.filled_cavities,
            "deviation": asdict(body.deviation),
            "volume_change": body.volume_change,
            "area_change": body.area_change,
            "source_triangles": mesh.triangles,
            "vertices": len(body.vertices),
            "triangles": len(body.faces),
            "centre": body.centre,
            "scale": body.scale,
            "longest_side": body.longest_side,
            "size_m": size_m,
            "size_origin": source.get("size_origin"),
            "volume": surfaces.volume(body.vertices, body.faces),
            "area": surfaces.area(body.vertices, body.faces),
            "genus": surfaces.topology(body.faces, len(body.vertices)).genus,
        }
    )


class _Source(NamedTuple):
    """What the record says of a mesh file."""

    triangles: int
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def _read_and_clean(
    clean: Callable, path: Path, format: str, name: str | None, options: Clean
) -> tuple[CleanSurface, _Source]:
    """Return the cleaned body of a mesh file, and what its reader says."""
    from vibraverse.files.meshes import read_mesh

    mesh = read_mesh(path, format, name, options.max_triangles)
    body = clean(
        mesh.vertices,
        mesh.faces,
        options.max_triangles,
        options.max_dropped,
        options.max_joined,
        options.open_sheets,
        options.sheet_thickness,
    )
    return body, _Source(len(mesh.faces), mesh.notes, mesh.warnings)


def prepare() -> None:
    """Import every format, and call each compiled loop once, because Numba reads its cache on the first call."""
    import numpy as np

    from vibraverse.files import formats
    from vibraverse.geometry.cleaning.clean import clean
    from vibraverse.geometry.distance.field import grid_distance

    formats.known()
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    body = clean(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    grid_distance(body.vertices, body.faces, *[np.linspace(-0.9, 0.9, 8)] * 3)
