"""Stage ``hollow``: the surface and its signed distance in, the surface of the hollow body out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Read the surface and its distance grid, draw the wall thickness, and write the hollow body's surface."""
    import h5py

    from vibraverse.contract.limits import run_limited
    from vibraverse.contract.seeds import rng
    from vibraverse.files import meshes
    from vibraverse.geometry import surfaces
    from vibraverse.geometry.hollow import hollow

    vertices, faces = meshes.read_ply(job.inputs["surface"])
    with h5py.File(job.inputs["grids"], "r") as h5:
        distance = h5["signed_distance"][:]
    t = float(rng(job.object, "hollow").uniform(*job.options.thickness))
    limits = job.options.limits
    body = run_limited(
        hollow,
        vertices,
        faces,
        distance,
        t,
        job.options.min_kept,
        seconds=limits.seconds,
        memory_mb=limits.memory_mb,
        key="hollow.limits",
        what="The cavity's mesher",
    )
    meshes.write_ply(job.outputs["hollow_surface"], body.vertices, body.faces)
    job.write_record(
        {
            "object": job.object,
            "t": t,
            "s_min": body.s_min,
            "deepest_point": body.deepest,
            "wall": -t * body.s_min,
            "cavities": body.cavities,
            "specks": body.specks,
            "asked_volume": body.asked,
            "kept_share": body.kept,
            "outside_triangles": len(faces),
            "triangles": len(body.faces),
            "volume": surfaces.volume(body.vertices, body.faces),
        }
    )
