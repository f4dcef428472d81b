"""Stage ``images``: the surface in, pictures of the outside in every look and view out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write a picture per look and view; the file's stem names both.

    The renderer runs in this process. If a driver crashes it, the job fails and is retried, because that is the
    machine's fault and never the object's.
    """
    import meshio
    import numpy as np

    from vibraverse.media import images

    options = job.options
    surface = meshio.read(job.inputs["surface"])
    views = images.views_around(options.views)
    rendering = images.render_views(
        surface.points, np.asarray(surface.cells_dict["triangle"]), views, options.looks, options.size_px
    )
    for name in options.names():
        look, _, view = name.rpartition("-")
        (job.outputs["views"] / f"{name}.png").write_bytes(
            images.png_bytes(rendering.pictures[look][int(view)])
        )
    job.write_record(
        {
            "object": job.object,
            "views": [
                {"azimuth_deg": view.azimuth_deg, "elevation_deg": view.elevation_deg} for view in views
            ],
            "looks": options.looks,
            "size_px": options.size_px,
            "camera_distance": rendering.camera_distance,
            "field_of_view_deg": images.FIELD_OF_VIEW_DEG,
            "renderer": rendering.renderer,
        }
    )


def prepare() -> None:
    """Load the renderer with its shader compiler, and the PNG writer. Draw nothing: that would start threads."""
    from PIL import Image

    from vibraverse.media.images import choose_window

    Image.preinit()
    choose_window()
