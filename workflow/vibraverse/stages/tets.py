"""Stage ``tets``: the boundary surface of a body in, tetrahedra out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Read the surface, mesh the body in a child process, and write the tetrahedra and their record."""
    from vibraverse.files import meshes
    from vibraverse.files.tets import write_tets
    from vibraverse.geometry import surfaces
    from vibraverse.geometry.meshing import tets

    surface = meshes.read_mesh(job.inputs["surface"], "ply")
    mesh = tets.mesh_body(surface.vertices, surface.faces, job.options)
    write_tets(job.outputs["tets"], mesh.points, mesh.cells)
    job.write_record(
        {
            "object": job.object,
            "solidity": job.solidity,
            "vertices": len(mesh.points),
            "tetrahedra": len(mesh.cells),
            "volume": float(tets.quality.volumes(mesh.points, mesh.cells).sum()),
            "surface_volume": surfaces.volume(surface.vertices, surface.faces),
            "quality": mesh.quality,
            "warnings": mesh.warnings,
        }
    )
