"""Stage ``grids``: the surface in, occupancy and signed distance on grids out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Read the surface; write both grids and the box mesh of the coarse one."""
    import numpy as np

    from vibraverse.files import meshes
    from vibraverse.geometry import grids, voxels

    vertices, faces = meshes.read_ply(job.inputs["surface"])
    body = grids.Sampler(vertices, faces, job.threads)
    occupied, distance = body.occupancy(job.options.coarse), body.signed_distance(job.options.fine)
    if not occupied.any():
        occupied = grids.thickest_cell(distance, job.options.coarse)
    write_obj(job.outputs["coarse"], *voxels.coarse_mesh(occupied))
    write_grids(job.outputs["grids"], occupied.astype(np.uint8), distance, job.provenance("coarse"))


def write_grids(path, occupied, distance, provenance: dict) -> None:
    """Write both grids as compressed HDF5 datasets with description, axes and unit."""
    from vibraverse.contract.products import hdf5, write_provenance

    with hdf5(path) as h5:
        for name, data, what in (
            ("occupancy", occupied, "1 where the cell centre is inside"),
            ("signed_distance", distance, "distance to the surface, negative inside"),
        ):
            chunk = tuple(min(side, 64) for side in data.shape)
            dataset = h5.create_dataset(
                name, data=data, chunks=chunk, compression="gzip", compression_opts=1, shuffle=True
            )
            dataset.attrs["description"] = what
            dataset.attrs["axes"] = "x, y, z; sample i of n is the cell centre -1 + (2 i + 1) / n"
        h5["occupancy"].attrs["unit"] = "1"
        h5["signed_distance"].attrs["unit"] = "normalised length (longest side of the bounding box = 1.8)"
        write_provenance(h5, provenance)


def write_obj(path, vertices, faces) -> None:
    """Write a mesh as OBJ text."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
