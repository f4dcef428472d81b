"""Stage ``validation_meshes``: tetrahedra of one body with known frequencies, coarse to fine."""

from __future__ import annotations

from vibraverse.contract.products import hdf5, write_provenance
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Make the body's surface, clean it, hollow it if the body is hollow, and mesh it."""
    from vibraverse.validation.bodies import BODIES
    from vibraverse.validation.meshes import meshes

    scale_m, made = meshes(BODIES[job.object])
    with hdf5(job.outputs["meshes"]) as h5:
        h5.attrs["scale_m"] = scale_m
        for number, mesh in enumerate(made):
            group = h5.create_group(str(number))
            group.create_dataset("points", data=mesh.points).attrs["unit"] = "normalised length"
            group.create_dataset("cells", data=mesh.cells).attrs["unit"] = "index into points"
        write_provenance(h5, job.provenance())
    print(f"meshes of {', '.join(str(len(mesh.cells)) for mesh in made)} tetrahedra")
