"""The stage ``images``: framing, light, looks, repeatability; and the looks themselves."""

from __future__ import annotations

import json

import meshio
import numpy as np
import pytest
from PIL import Image

from vibraverse.config.media import Images
from vibraverse.contract.products import sha256
from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.media import images
from vibraverse.media.looks import LOOKS, look_of
from vibraverse.physics.materials import MATERIALS

BACKDROP = np.round(np.array(images.BACKGROUND) * 255)


def ball(rings: int = 24):
    """A sphere of radius 0.9 by longitude and latitude."""
    polar, around = np.meshgrid(
        np.linspace(0, np.pi, rings), np.arange(2 * rings) * np.pi / rings, indexing="ij"
    )
    vertices = 0.9 * np.stack(
        [np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1
    ).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(rings - 1), np.arange(2 * rings), indexing="ij")
    a, b = row * 2 * rings + column, row * 2 * rings + (column + 1) % (2 * rings)
    c, d = a + 2 * rings, b + 2 * rings
    return vertices, np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])


def box(size):
    """A box with the given sides around the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * size
    faces = [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]  # fmt: skip
    return corners, np.array(faces)


def covered(picture):
    """Return the mask of the pixels that show the object."""
    return (np.abs(picture.astype(float) - BACKDROP) > 3).any(axis=-1)


@pytest.fixture(scope="module")
def pictures():
    """Every look of a ball, from the front and from below."""
    views = [images.View(20.0, 25.0), images.View(200.0, -20.0)]
    return images.render_views(*ball(), views, [*LOOKS, "moon-dust"], 96).pictures


def test_every_material_has_a_look():
    assert set(MATERIALS) | {"clay"} == set(LOOKS)
    assert look_of("moon-dust") == LOOKS["clay"]


def test_looks_differ_and_an_unknown_one_is_clay(pictures):
    assert (pictures["moon-dust"] == pictures["clay"]).all()
    means = {name: pictures[name][covered(pictures["clay"])].mean(axis=0) for name in LOOKS}
    for name, mean in means.items():
        others = [np.abs(mean - other).max() for key, other in means.items() if key != name]
        assert min(others) > 3, name
    red, green, blue = means["plastic"]
    assert red > 2 * green
    assert red > 2 * blue
    assert means["iron"].mean() < means["steel"].mean() < means["tin"].mean()
    # What is clear lets the backdrop shine through; what is polished shows more contrast than what is dull.
    assert means["glass"].mean() > means["clay"].mean()
    assert (
        pictures["steel"][covered(pictures["clay"])].std() > pictures["clay"][covered(pictures["clay"])].std()
    )


def test_the_whole_ball_is_in_the_picture(pictures):
    for picture in pictures["clay"]:
        mask = covered(picture)
        rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        assert abs(rows[0] + rows[-1] - 95) <= 2
        assert abs(columns[0] + columns[-1] - 95) <= 2
        assert rows[-1] - rows[0] + 1 == pytest.approx(images.FILL * 96, abs=2.5)
        np.testing.assert_array_equal(picture[[0, 0, -1, -1], [0, -1, 0, -1]], np.tile(BACKDROP, (4, 1)))


def test_light_comes_from_the_upper_left(pictures):
    for picture in pictures["clay"]:
        brightness = np.where(covered(picture), picture.mean(axis=-1), 0)
        bright = np.argwhere(brightness > np.quantile(brightness[brightness > 0], 0.95)).mean(axis=0)
        assert bright[0] < 47
        assert bright[1] < 47


@pytest.mark.parametrize("size", [(1.8, 0.1, 0.1), (0.2, 0.3, 1.8), (1.8, 1.8, 1.8), (1.8, 1.8, 0.02)])
@pytest.mark.parametrize("count", [1, 6, 17])
def test_camera_frames_every_view_tightly(size, count):
    vertices, _ = box(size)
    views = images.views_around(count)
    distance = images.camera_distance(vertices, views)
    widest = 0.0
    for view in views:
        axes = view.axes()
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        seen = vertices @ axes.T
        slope = np.tan(np.radians(images.FIELD_OF_VIEW_DEG) / 2)
        widest = max(widest, (np.abs(seen[:, :2]).max(axis=1) / (distance - seen[:, 2]) / slope).max())
    assert widest == pytest.approx(images.FILL)


def test_views_are_spread_around():
    views = images.views_around(6)
    azimuths = np.sort([view.azimuth_deg for view in views])
    np.testing.assert_allclose(np.diff(azimuths), 60.0)
    assert {view.elevation_deg for view in views} == set(images.ELEVATIONS_DEG)


def test_sharp_edges_stay_sharp():
    view = [images.View(45.0, 0.0)]
    picture = images.render_views(*box((1.2, 1.2, 1.2)), view, ["clay"], 96).pictures["clay"][0]
    row = picture[48].astype(float).mean(axis=-1)
    left, right = row[28:46], row[50:68]
    # Two faces meet in the middle: each nearly even, and clearly unlike.
    assert np.ptp(left) < 12
    assert np.ptp(right) < 12
    assert abs(left.mean() - right.mean()) > 15


@pytest.fixture
def surface(tmp_path):
    path = tmp_path / "surface.ply"
    vertices, faces = ball(12)
    meshio.write(path, meshio.Mesh(vertices, [("triangle", faces.astype(np.int32))]))
    return path


def render(vibraverse, surface, folder="views", looks=("clay", "glass", "wood")):
    folder = surface.parent / folder
    options = {"views": 2, "size_px": 48, "looks": looks}
    status, _, errors = vibraverse(
        "images", "--object", "x", "--surface", surface, "--views", folder, "--options", json.dumps(options)
    )
    return status, errors, folder


def test_stage_writes_the_same_bytes_twice(vibraverse, surface):
    names = Images(views=2, looks=["clay", "glass", "wood"]).names()
    assert names == ["clay-00", "clay-01", "glass-00", "glass-01", "wood-00", "wood-01"]
    digests = []
    for name in ("first", "second"):
        status, errors, folder = render(vibraverse, surface, name)
        assert status == 0, errors
        digests.append({path.name: sha256(path) for path in folder.iterdir()})
    assert digests[0] == digests[1]
    assert sorted(digests[0]) == sorted([*(f"{name}.png" for name in names), "images.json"])
    with Image.open(folder / "clay-00.png") as picture:
        assert (picture.size, picture.mode, picture.info) == ((48, 48), "RGB", {})
    record = json.loads((folder / "images.json").read_text())
    assert record["provenance"]["output_sha256"]["views"]["wood-01.png"] == digests[0]["wood-01.png"]
    assert record["looks"] == ["clay", "glass", "wood"]
    assert record["views"][0] == {"azimuth_deg": 20.0, "elevation_deg": 25.0}
    assert record["size_px"] == 48
    assert record["renderer"] != "unknown"


def test_replaces_the_folder_as_a_whole(vibraverse, surface):
    render(vibraverse, surface)
    _, _, folder = render(vibraverse, surface, looks=["tin"])
    kept = ["images.json", "tin-00.png", "tin-01.png"]
    assert sorted(path.name for path in folder.iterdir()) == kept
    (folder / "photo.png").write_text("mine")
    status, errors, _ = render(vibraverse, surface)
    assert status == 2
    assert "holds 'photo.png', which this stage did not write" in errors
    assert sorted(path.name for path in folder.iterdir()) == sorted([*kept, "photo.png"])


def test_passes_refusals_on(vibraverse, surface):
    surface.write_text(Refusal("x", "clean", "empty", "The file holds no triangles.").to_text())
    status, _, folder = render(vibraverse, surface)
    assert status == 0
    assert [path.name for path in folder.iterdir()] == ["images.json"]
    assert read_refusal(folder / "images.json").reason == "empty"
