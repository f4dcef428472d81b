"""Pictures of a surface: one light studio, one camera that always sees the whole object, a look per material.

VTK shades physically (metallic-roughness model) in the image-based light of a studio with soft boxes. A few lines of
GLSL add what VTK lacks: refraction for clear materials, growth rings for wood, and a film curve that preserves
highlights. Frames are drawn larger and averaged down. No screen is needed: OSMesa draws in memory, or else EGL does.
"""

from __future__ import annotations

import ctypes
import io
import math
import os
from dataclasses import dataclass

import numpy as np
from PIL import Image

from vibraverse.media import shaders
from vibraverse.media.looks import look_of

#: Elevations of the views, in rotation.
ELEVATIONS_DEG = (25.0, 5.0, 50.0, -20.0)
FIRST_AZIMUTH_DEG = 20.0
FIELD_OF_VIEW_DEG = 28.0
#: Share of the picture's half width that the object may fill.
FILL = 0.92
#: Edges with a larger angle look sharp; others are shaded smoothly.
FEATURE_ANGLE_DEG = 40.0
BACKGROUND = (0.925, 0.93, 0.94)
#: Frames are drawn this many times larger and averaged down, but not larger than ``_MAX_DRAWN_PX``.
_SUPERSAMPLING, _MAX_DRAWN_PX = 3, 4096
#: VTK's off-screen windows, best first; each needs one of its libraries.
_WINDOWS = {
    "vtkOSOpenGLRenderWindow": ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"),
    "vtkEGLRenderWindow": ("libEGL.so.1", "libEGL.so"),
}
_WINDOW_VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"


@dataclass(frozen=True)
class View:
    """A viewing direction: azimuth from +x towards +y, elevation from the xy plane."""

    azimuth_deg: float
    elevation_deg: float

    def axes(self) -> np.ndarray:
        """Return the camera's axes as rows (3, 3): right, up, and backward, towards the camera."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        back = (
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        )
        right = (-math.sin(azimuth), math.cos(azimuth), 0.0)
        return np.array([right, np.cross(back, right), back])


@dataclass(frozen=True)
class Rendering:
    """Pictures by look, ``{look: (views, size_px, size_px, 3) uint8}``, and how they were made."""

    pictures: dict[str, np.ndarray]
    camera_distance: float
    renderer: str


def views_around(count: int) -> list[View]:
    """Return ``count`` views, evenly spaced in azimuth, with elevations in rotation."""
    return [
        View((FIRST_AZIMUTH_DEG + 360.0 * index / count) % 360.0, ELEVATIONS_DEG[index % len(ELEVATIONS_DEG)])
        for index in range(count)
    ]


def camera_distance(points, views: list[View]) -> float:
    """Return the smallest camera distance from the origin at which every view shows all ``points`` (V, 3).

    A point ``(x, y, z)`` in camera axes is inside the picture when ``max(|x|, |y|) <= (D - z) tan(fov/2)``. The slope
    is multiplied by :data:`FILL`.
    """
    slope = FILL * math.tan(math.radians(FIELD_OF_VIEW_DEG) / 2)
    points = np.asarray(points, dtype=np.float64)
    nearest = 0.0
    for view in views:
        seen = points @ view.axes().T
        nearest = max(nearest, float((seen[:, 2] + np.abs(seen[:, :2]).max(axis=1) / slope).max()))
    return nearest


def studio(height: int = 128) -> np.ndarray:
    """Return the environment light (height, 2·height, 3), linear radiance by direction.

    Rows run from the zenith down. Azimuths count from the camera to its right; VTK's columns start at the left and run
    through the back. A soft sky darkens towards the floor. A large key light stands at the upper left, a weaker fill
    light at the right, and two rim lights behind.
    """
    elevation = (0.5 - (np.arange(height) + 0.5) / height)[:, None] * math.pi
    azimuth = (1.5 - (np.arange(2 * height) + 0.5) / height)[None, :] * math.pi
    sky = 0.20 + 0.30 * np.clip(np.sin(elevation), 0, None) - 0.12 * np.clip(-np.sin(elevation), 0, 1) ** 0.5

    def box(azimuth_deg, elevation_deg, width_deg, height_deg, radiance, colour, soft_deg=3.0):
        across = (azimuth - math.radians(azimuth_deg) + math.pi) % (2 * math.pi) - math.pi
        inside = 1.0
        for offset, full in ((across, width_deg), (elevation - math.radians(elevation_deg), height_deg)):
            edge = (math.radians(full / 2) - np.abs(offset)) / math.radians(soft_deg)
            inside = inside / (1.0 + np.exp(-np.clip(edge, -40, 40)))
        return radiance * inside[:, :, None] * np.array(colour)

    light = (sky + 0 * azimuth)[:, :, None] * np.array([0.97, 0.99, 1.03])
    light = light + box(-58, 36, 44, 36, 12.0, (1.0, 0.97, 0.93))
    light = light + box(60, 15, 20, 80, 1.8, (0.93, 0.97, 1.0))
    light = light + box(150, 30, 30, 60, 3.5, (1.0, 1.0, 1.0)) + box(-140, 25, 20, 70, 2.0, (0.95, 0.98, 1.0))
    return np.ascontiguousarray(light, dtype=np.float32)


def render_views(vertices, faces, views: list[View], looks: list[str], size_px: int) -> Rendering:
    """Draw a closed surface from every view in every look.

    ``vertices`` (V, 3) and outward ``faces`` (F, 3) may lie anywhere: the centre of the bounding box is the centre of
    the picture. Raises ``RuntimeError`` when the machine has no off-screen renderer or it draws an empty picture.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    distance = camera_distance(vertices, views)
    radius = float(np.linalg.norm(vertices, axis=1).max())
    plotter, scale = _plotter(size_px)
    try:
        renderer = _light(plotter)
        surface = _smooth(vertices, faces)
        actors = {name: _actors(plotter, surface, look_of(name)) for name in looks}
        shown = [actor for layers in actors.values() for actor in layers]
        plotter.show(auto_close=False, interactive=False)
        camera = plotter.camera
        camera.view_angle = FIELD_OF_VIEW_DEG
        camera.clipping_range = (max(0.05 * distance, distance - 1.01 * radius), distance + 1.01 * radius)
        pictures = {name: np.empty((len(views), size_px, size_px, 3), np.uint8) for name in actors}
        for index, view in enumerate(views):
            right, up, back = view.axes()
            camera.focal_point, camera.position, camera.up = (0, 0, 0), back * distance, up
            # The studio turns with the camera, so every view is well lit. Its vertical does not change.
            renderer.SetEnvironmentUp(0, 0, 1)
            renderer.SetEnvironmentRight(*right)
            for name, layers in actors.items():
                for actor in shown:
                    actor.SetVisibility(False)
                for actor in layers:
                    actor.SetVisibility(True)
                shown = layers
                plotter.render()
                frame = plotter.screenshot(return_img=True)
                pictures[name][index] = Image.fromarray(frame).reduce(scale)
        description = plotter.render_window.ReportCapabilities()
    finally:
        plotter.close()
    if any((drawn == drawn[0, 0, 0]).all() for drawn in pictures.values()):
        raise RuntimeError(f"the renderer drew an empty picture; its description: {description[:500]}")
    return Rendering(pictures, distance, _renderer_name(description))


def render_poses(poses: np.ndarray, faces, view: View, look: str, size_px: int) -> np.ndarray:
    """Draw a surface in several poses (n, V, 3), all from one view; return the pictures (n, size_px, size_px, 3) uint8.

    Raises as :func:`render_views`. The surface should be centred at the origin.
    """
    poses = np.asarray(poses, dtype=np.float64)
    distance = camera_distance(poses.reshape(-1, 3), [view])
    plotter, scale = _plotter(size_px)
    pictures = np.empty((len(poses), size_px, size_px, 3), np.uint8)
    try:
        renderer = _light(plotter)
        plotter.show(auto_close=False, interactive=False)
        camera = plotter.camera
        right, up, back = view.axes()
        camera.view_angle = FIELD_OF_VIEW_DEG
        camera.focal_point, camera.position, camera.up = (0, 0, 0), back * distance, up
        camera.clipping_range = (0.05 * distance, 2 * distance)
        renderer.SetEnvironmentUp(0, 0, 1)
        renderer.SetEnvironmentRight(*right)
        for picture, pose in zip(pictures, poses, strict=True):
            actors = _actors(plotter, _smooth(pose, faces), look_of(look))
            plotter.render()
            picture[:] = Image.fromarray(plotter.screenshot(return_img=True)).reduce(scale)
            plotter.remove_actor(actors, render=False)
    finally:
        plotter.close()
    if (pictures == pictures[0, 0, 0]).all():
        raise RuntimeError("the renderer drew an empty picture")
    return pictures


def _plotter(size_px: int):
    """Return an off-screen plotter, and how many times larger than a picture it draws."""
    choose_window()
    import pyvista

    scale = max(1, min(_SUPERSAMPLING, _MAX_DRAWN_PX // size_px))
    plotter = pyvista.Plotter(off_screen=True, window_size=(scale * size_px,) * 2, lighting="none")
    plotter.disable_anti_aliasing()
    return plotter, scale


def png_bytes(picture: np.ndarray) -> bytes:
    """Return a picture (H, W, 3) as a PNG file, without a time stamp."""
    file = io.BytesIO()
    Image.fromarray(picture).save(file, format="PNG")
    return file.getvalue()


def _renderer_name(description: str) -> str:
    """Return the name of the OpenGL renderer from VTK's report."""
    lines = (line.partition("OpenGL renderer string:") for line in description.splitlines())
    return next((name.strip() for _, found, name in lines if found), "unknown")


def choose_window() -> None:
    """Select VTK's off-screen window before its first use, OSMesa or EGL; raises ``RuntimeError`` without them."""
    if os.environ.get(_WINDOW_VARIABLE):
        return
    for window, libraries in _WINDOWS.items():
        if any(_loads(library) for library in libraries):
            os.environ[_WINDOW_VARIABLE] = window
            return
    raise RuntimeError(
        "this machine has no off-screen renderer: install OSMesa (Debian: libosmesa6) "
        "or EGL (Debian: libegl1 and libgl1-mesa-dri)"
    )


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _light(plotter):
    """Light the scene with the studio; return the renderer."""
    import pyvista

    plotter.background_color = BACKGROUND
    light = studio()
    image = pyvista.ImageData(dimensions=(light.shape[1], light.shape[0], 1))
    image.point_data["radiance"] = light[::-1].reshape(-1, 3)
    image.point_data.active_scalars_name = "radiance"
    texture = pyvista.Texture(image)
    texture.SetColorModeToDirectScalars()
    texture.MipmapOn()
    texture.InterpolateOn()
    renderer = plotter.renderer
    renderer.UseImageBasedLightingOn()
    renderer.UseSphericalHarmonicsOn()
    renderer.SetEnvironmentTexture(texture, False)
    renderer.GetEnvMapPrefiltered().SetPrefilterMaxSamples(128)
    return renderer


def _smooth(vertices, faces):
    """Return the surface with normals that are smooth across flat edges and split at sharp ones."""
    import pyvista

    surface = pyvista.PolyData.from_regular_faces(vertices.astype(np.float32), np.asarray(faces))
    return surface.compute_normals(
        cell_normals=False,
        split_vertices=True,
        feature_angle=FEATURE_ANGLE_DEG,
        consistent_normals=False,
        auto_orient_normals=False,
    )


def _linear(colour) -> list[float]:
    """Return linear RGB from sRGB."""
    return [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]


def _actors(plotter, surface, look) -> list:
    """Add a surface to the scene; a clear one as two layers, the far side before the near side."""
    if look.kind != "clear":
        return [_actor(plotter, surface, look)]
    far, near = _actor(plotter, surface, look), _actor(plotter, surface, look)
    far.prop.SetFrontfaceCulling(True)
    near.prop.SetBackfaceCulling(True)
    near.ForceTranslucentOn()
    return [far, near]


def _actor(plotter, surface, look):
    actor = plotter.add_mesh(
        surface,
        pbr=True,
        color="white",
        metallic=look.metallic,
        roughness=look.roughness,
        smooth_shading=True,
        reset_camera=False,
    )
    actor.prop.SetColor(*_linear(look.colour))
    shaders.dress(actor, look.kind, _linear(BACKGROUND), _linear(look.second))
    return actor
