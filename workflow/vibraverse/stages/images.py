"""Pictures of the outside: every look from every side."""

from __future__ import annotations

from vibraverse.config.media import Images
from vibraverse.stage import Job, Stage


def run(job: Job) -> None:
    """Write one picture per output file; the file's stem says which look, seen from which view.

    The renderer runs in this process: should a driver crash it, the job fails as a whole and is run again,
    because that is the machine's fault and never the object's.
    """
    import meshio
    import numpy as np

    from vibraverse.cli import UsageError
    from vibraverse.media import images

    options = job.options
    wanted = {}
    for final, path in zip(job.final["views"], job.outputs["views"], strict=True):
        look, _, view = final.stem.rpartition("-")
        if final.suffix != ".png" or not look or not view.isdigit() or int(view) >= options.views:
            raise UsageError(f"views: {final.name!r} is not LOOK-VIEW.png with VIEW below {options.views}")
        wanted[path] = (look, int(view))
    looks = list(dict.fromkeys(look for look, _ in wanted.values()))

    surface = meshio.read(job.inputs["surface"])
    views = images.views_around(options.views)
    rendering = images.render_views(
        surface.points, np.asarray(surface.cells_dict["triangle"]), views, looks, options.size_px
    )
    for path, (look, view) in wanted.items():
        path.write_bytes(images.png_bytes(rendering.pictures[look][view]))
    job.write_record(
        {
            "object": job.object,
            "views": [
                {"azimuth_deg": view.azimuth_deg, "elevation_deg": view.elevation_deg} for view in views
            ],
            "looks": looks,
            "size_px": options.size_px,
            "camera_distance": rendering.camera_distance,
            "field_of_view_deg": images.FIELD_OF_VIEW_DEG,
            "renderer": rendering.renderer,
        }
    )


STAGE = Stage(
    name="images",
    help="render views of the outside",
    inputs={"surface": "surface.ply: the closed, normalised surface"},
    outputs={
        "views": "PNG files; stem LOOK-VIEW, for instance clay-00",
        "record": "images.json: directions, looks and camera",
    },
    run=run,
    options=Images,
    many=frozenset({"views"}),
    libraries=("numpy", "pyvista", "vtk", "pillow", "meshio"),
)
