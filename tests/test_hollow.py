"""hollow: cavities of bodies with a formula, thin bodies, and the stage's products."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import shapes
from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import read_refusal
from vibraverse.contract.seeds import rng
from vibraverse.files import meshes
from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.grids import Sampler
from vibraverse.geometry.hollow import deepest_point, hollow
from vibraverse.geometry.voxels import cell_centres
from vibraverse.sources.families import generate


def deepest(vertices, faces):
    """Return ``s_min`` and the point where it is, from a coarse grid."""
    grid = Sampler(vertices, faces).signed_distance(32)
    return deepest_point((vertices, faces), ClosestPoint(vertices, faces), grid)


def check_hollow(body, vertices, faces):
    """Assert what holds for every hollow body; return its cavities as outward surfaces."""
    assert np.array_equal(body.vertices[: len(vertices)], vertices)
    assert np.array_equal(body.faces[: len(faces)], faces)
    found = surfaces.topology(body.faces, len(body.vertices))
    assert found.closed_manifold
    assert found.components == 1 + len(body.cavities)
    assert not crossing_faces(body.vertices, body.faces).any()
    inside = body.faces[len(faces) :, ::-1]
    points, triangles = surfaces.compact(body.vertices, inside)
    assert all(surfaces.volume(*part) > 0 for part in repair.parts(points, triangles))
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(
        surfaces.volume(vertices, faces) - sum(body.cavities)
    )
    return points, triangles


@pytest.fixture(scope="module")
def ball():
    vertices, faces = shapes.ball(subdivisions=3)
    return vertices, faces, Sampler(vertices, faces).signed_distance(48)


@pytest.mark.parametrize("t", [0.3, 0.5, 0.7])
def test_a_ball_gets_a_concentric_cavity(ball, t):
    body = hollow(*ball, t)
    points, _ = check_hollow(body, *ball[:2])
    assert body.s_min == pytest.approx(-0.9, abs=6e-3)  # facets lie below the sphere
    assert np.linalg.norm(body.deepest) < 1e-2
    assert np.allclose(np.linalg.norm(points, axis=1), 0.9 * (1 - t), atol=9e-3)
    assert body.cavities[0] == pytest.approx(4 / 3 * np.pi * (0.9 * (1 - t)) ** 3, rel=0.05)
    assert body.specks == 0


def test_a_turned_body_has_the_same_cavity():
    """Samples lie along the principal axes: a wedge-shaped cavity ends at the same place however the body lies."""
    vertices, faces = shapes.cylinder(0.8, 0.3)
    vertices = vertices * (1.0 + 0.3 * vertices[:, :1])  # without a symmetry but that of top and bottom
    found = []
    for turn in (np.eye(3), Rotation.from_euler("xyz", [50, 20, 70], degrees=True).as_matrix()):
        surface = vertices @ turn.T, faces
        body = hollow(*surface, Sampler(*surface).signed_distance(64), 0.6)
        check_hollow(body, *surface)
        points = body.vertices[np.unique(body.faces[len(faces) :])] @ turn
        found.append((sum(body.cavities), *points.min(axis=0), *points.max(axis=0)))
    straight, turned = np.array(found)
    assert turned[0] == pytest.approx(straight[0], rel=2e-3)
    assert np.abs(turned[1:] - straight[1:]).max() < 0.004


def test_the_wall_of_a_box_is_as_thick_as_asked():
    vertices, faces = shapes.box((1.8, 1.0, 0.7))
    body = hollow(vertices, faces, Sampler(vertices, faces).signed_distance(64), 0.4)
    points, triangles = check_hollow(body, vertices, faces)
    assert body.s_min == pytest.approx(-0.35, abs=1e-5)
    wall = np.linalg.norm(ClosestPoint(vertices, faces)(points) - points, axis=1)
    assert np.percentile(wall, 10) == pytest.approx(0.14, abs=0.01)
    assert wall.min() > 0.12
    sides = np.array([1.8, 1.0, 0.7]) - 0.28
    assert body.cavities[0] == pytest.approx(sides.prod(), rel=0.03)
    assert body.asked == pytest.approx(sides.prod(), rel=0.005)
    assert body.kept == pytest.approx(body.cavities[0] / sides.prod(), rel=0.005)
    assert len(triangles) < 6000


def test_the_deepest_point_is_found_below_the_grid():
    vertices, faces = shapes.box((1.8, 0.731, 0.5))
    centre = np.array([0.01, 0.02, 0.0137])
    vertices = vertices + centre
    s_min, point = deepest(vertices, faces)
    assert s_min == pytest.approx(-0.25, abs=1e-5)
    assert point[2] == pytest.approx(0.0137, abs=1e-4)


def test_the_centre_of_a_ball_ends_no_search():
    """All neighbouring cells are shallower by exactly the search bound, up to rounding."""
    random, n = rng("t", "ball"), 16
    places = np.stack(np.meshgrid(*[cell_centres(n)] * 3, indexing="ij"), axis=-1)
    for _ in range(20):
        cell = 1 / n / 2 ** random.integers(1, 9)
        centre = cell * (2 * random.integers(-0.25 / cell, 0.25 / cell, 3) + 1)
        radius = random.uniform(0.3, 0.5)

        class Ball:
            def distance(self, points, centre=centre, radius=radius):
                return np.abs(radius - np.linalg.norm(points - centre, axis=1))

        s_min, deepest = deepest_point(
            (None, None), Ball(), np.linalg.norm(places - centre, axis=-1) - radius
        )
        assert s_min == pytest.approx(-radius, abs=1e-12)
        assert deepest == pytest.approx(centre, abs=1e-12)


def test_the_deepest_point_of_a_body_full_of_creases_is_found():
    """The centre of a tetrahedron: from most places depth rises along creases alone."""
    corners = 0.9 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    turn = Rotation.from_euler("xyz", (0.3, 0.5, 0.7)).as_matrix()
    vertices, faces = corners @ turn / np.sqrt(3), np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    s_min, point = deepest(vertices, faces)
    assert s_min == pytest.approx(-0.3, abs=2e-5)  # a third of the circumscribed radius
    assert np.linalg.norm(point) < 1e-4


def test_a_cavity_does_not_depend_on_how_the_body_lies():
    source = generate("bowl-0000")
    shares = []
    for angles in ((0, 0, 0), (0.4, 0.7, 0.2)):
        body = clean(source.vertices @ Rotation.from_euler("xyz", angles).as_matrix(), source.faces)
        surface = body.vertices, body.faces
        made = hollow(*surface, Sampler(*surface).signed_distance(128), 0.5)
        shares.append(sum(made.cavities) / surfaces.volume(*surface))
    # Its wall is four cells of the grid thick.
    assert shares[1] == pytest.approx(shares[0], rel=3e-3)


def test_two_rooms_joined_by_a_thin_neck_stay_two():
    (a, b), join = (shapes.ball(0.4, 3, (0, 0, z)) for z in (-0.5, 0.5)), shapes.cylinder(0.06, 0.6, 24)
    vertices, faces = repair.join([a, b, join])
    body = hollow(vertices, faces, Sampler(vertices, faces).signed_distance(64), 0.5)
    check_hollow(body, vertices, faces)
    assert len(body.cavities) == 2
    assert body.cavities[0] == pytest.approx(body.cavities[1], rel=0.01)
    assert body.cavities[0] == pytest.approx(4 / 3 * np.pi * 0.2**3, rel=0.06)


def test_a_thin_plate_is_sampled_finer():
    vertices, faces = shapes.box((1.8, 1.0, 0.12))
    body = hollow(vertices, faces, Sampler(vertices, faces).signed_distance(64), 0.5)
    check_hollow(body, vertices, faces)
    # The cavity is less than two grid cells thick.
    assert body.cavities[0] == pytest.approx(1.74 * 0.94 * 0.06, rel=0.05)


def test_a_thin_bowl_keeps_its_cavity():
    """Its cavity is a thin shell with an edge all around, where fitting the triangles goes astray."""
    vertices, faces = shapes.bowl(0.3, 0.034)
    body = hollow(vertices, faces, Sampler(vertices, faces).signed_distance(128), 0.57)
    check_hollow(body, vertices, faces)
    assert body.kept > 0.95
    # A shell of 0.43 of the thickness, up to 0.57 of half of it below the rim.
    middle, thickness = 0.3 - 0.034 / 2, 0.43 * 0.034
    assert body.cavities == pytest.approx([2 * np.pi * (middle**2 - middle * 0.0097) * thickness], rel=0.03)


@pytest.mark.parametrize("thickness", [0.01, 0.03])
def test_a_body_too_thin_for_a_cavity_is_refused(thickness):
    vertices, faces = shapes.box((1.8, 1.0, thickness))
    with pytest.raises(Refused) as refused:
        hollow(vertices, faces, Sampler(vertices, faces).signed_distance(64), 0.5)
    assert refused.value.reason == "too_thin"
    assert refused.value.advice


@pytest.fixture
def run(vibraverse, tmp_path):
    """Run the stage on a surface and its grid; return the products."""

    def call(vertices, faces, distance, name="run", **options):
        meshes.write_ply(tmp_path / "surface.ply", vertices, faces)
        with h5py.File(tmp_path / "grids.h5", "w") as h5:
            h5["signed_distance"] = distance
        products = tmp_path / f"{name}.ply", tmp_path / f"{name}.json"
        status, _, errors = vibraverse(
            *("hollow", "--object", "mine", "--surface", tmp_path / "surface.ply"),
            *("--grids", tmp_path / "grids.h5", "--hollow-surface", products[0], "--record", products[1]),
            *("--options", json.dumps(options)),
        )
        assert status == 0, errors
        return products

    return call


def test_the_stage_draws_the_wall_by_the_objects_seed(run, ball):
    surface, record = run(*ball)
    said = json.loads(record.read_text())
    assert said["t"] == float(rng("mine", "hollow").uniform(0.3, 0.7))
    assert said["wall"] == pytest.approx(-said["t"] * said["s_min"])
    vertices, faces = meshes.read_ply(surface)
    assert surfaces.volume(vertices, faces) == pytest.approx(said["volume"])
    assert said["outside_triangles"] == len(ball[1])
    again = run(*ball, name="again")
    assert [path.read_bytes() for path in again] == [surface.read_bytes(), record.read_bytes()]


def test_walls_are_drawn_evenly_from_the_whole_range():
    drawn = np.sort([rng(f"object-{number:04d}", "hollow").uniform(0.3, 0.7) for number in range(2000)])
    assert 0.3 <= drawn[0] < drawn[-1] < 0.7
    # Kolmogorov's distance from the even distribution; 1.95 / sqrt(n) is exceeded once in a thousand.
    even = 0.3 + 0.4 * (np.arange(2000) + 0.5) / 2000
    assert np.abs(drawn - even).max() / 0.4 < 1.95 / np.sqrt(2000)


def test_the_stage_refuses_a_thin_body(run):
    vertices, faces = shapes.box((1.8, 1.0, 0.01))
    surface, record = run(vertices, faces, Sampler(vertices, faces).signed_distance(32))
    assert read_refusal(surface) == read_refusal(record)
    assert read_refusal(record).reason == "too_thin"


def test_a_cavity_smaller_than_asked_is_refused(ball):
    kept = hollow(*ball, 0.5).kept
    assert hollow(*ball, 0.5, kept).kept == kept
    with pytest.raises(Refused, match=r"t = 0\.50") as refused:
        hollow(*ball, 0.5, kept + 1e-6)
    assert refused.value.reason == "too_thin"


def test_the_stage_refuses_a_cavity_not_worth_its_name(run, ball):
    assert json.loads(run(*ball)[1].read_text())["kept_share"] > 0.9
    surface, record = run(*ball, name="strict", min_kept=0.999)
    refusal = read_refusal(record)
    assert read_refusal(surface) == refusal
    assert refusal.reason == "too_thin"
    assert "hollow.min_kept" in refusal.advice


@pytest.mark.parametrize("thickness", [[0.7, 0.3], [0.0, 0.5], [0.5, 1.0]])
def test_an_impossible_range_is_one_sentence(vibraverse, tmp_path, thickness):
    paths = [tmp_path / name for name in ("s.ply", "g.h5", "h.ply", "h.json")]
    keys = ("--surface", "--grids", "--hollow-surface", "--record")
    arguments = [item for pair in zip(keys, paths, strict=True) for item in pair]
    options = json.dumps({"thickness": thickness})
    status, _, errors = vibraverse("hollow", "--object", "mine", *arguments, "--options", options)
    assert status == 2
    assert "hollow.thickness" in errors
    assert len(errors.strip().splitlines()) == 1
