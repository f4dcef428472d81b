"""grids: distances and occupancy against bodies with a formula, and the stage's files."""

from __future__ import annotations

import h5py
import numpy as np
import pytest

import shapes
from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import read_refusal
from vibraverse.files import meshes
from vibraverse.geometry import grids, surfaces
from vibraverse.geometry.cleaning.judge import judge
from vibraverse.geometry.grids import Sampler, thickest_cell
from vibraverse.geometry.voxels import cell_centres, coarse_mesh


def mesh_grid(n):
    x = cell_centres(n)
    return np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1)


def box_distance(points, half):
    """Signed distance to a box centred at the origin."""
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)


def test_samples_are_cell_centres():
    assert np.allclose(cell_centres(4), [-0.75, -0.25, 0.25, 0.75])
    assert cell_centres(128)[0] == -1 + 1 / 128


@pytest.mark.parametrize("sides", [(1.8, 1.8, 1.8), (1.8, 0.5, 0.25), (1.0, 1.75, 1.8)])
def test_the_distance_to_a_box_is_exact(sides):
    # Sides of 0.25, 0.5, 1 and 1.75 put faces of the box exactly on cell boundaries or through cell centres.
    found = Sampler(*shapes.box(sides)).signed_distance(32)
    wanted = box_distance(mesh_grid(32), np.array(sides) / 2)
    assert np.abs(np.abs(found) - np.abs(wanted)).max() < 2e-6
    clear = np.abs(wanted) > 1e-5
    assert np.array_equal(found[clear] < 0, wanted[clear] < 0)
    assert found.dtype == np.float32


def test_the_distance_is_negative_inside_a_body_with_a_hole():
    from trimesh.creation import torus

    mesh = torus(0.6, 0.3, major_sections=128, minor_sections=64)
    points = mesh_grid(40)
    found = Sampler(np.array(mesh.vertices), np.array(mesh.faces)).signed_distance(40)
    ring = np.hypot(points[..., 0], points[..., 1]) - 0.6
    assert np.abs(found - (np.hypot(ring, points[..., 2]) - 0.3)).max() < 2e-3


def test_rays_that_graze_edges_and_corners_are_cast_again():
    # An octahedron with its corners on the axes: with an odd number of cells a whole plane of rays meets edges.
    vertices = 0.9 * np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    assert surfaces.volume(vertices, faces) == pytest.approx(4 / 3 * 0.9**3)
    inside = Sampler(vertices, faces).occupancy(33)
    wanted = 0.9 - np.abs(mesh_grid(33)).sum(axis=-1)
    clear = np.abs(wanted) > 1e-5
    assert np.array_equal(inside[clear], wanted[clear] > 0)


def test_a_surface_with_a_hole_has_no_inside():
    vertices, faces = shapes.ball(subdivisions=2)
    without_cap = faces[vertices[faces][:, :, 2].min(axis=1) < 0.7]
    with pytest.raises(Refused, match="do not enter and leave the body alternately") as refused:
        Sampler(vertices, without_cap).occupancy(16)
    assert refused.value.reason == "too_thin"


def film(thickness, n=20):
    """Return a bent film: a closed surface whose two sides are ``thickness`` apart along z."""
    x = np.linspace(-0.9, 0.9, n)
    x, y = np.meshgrid(x, x, indexing="ij")
    side = np.stack([x, y, 0.05 * np.sin(3 * x) * np.cos(4 * y) + 0.1 * x], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    a, b, c, d = corner, corner + n, corner + n + 1, corner + 1
    top = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    rim = np.concatenate(
        [
            np.arange(0, n * n - n, n),
            np.arange(n * n - n, n * n - 1),
            np.arange(n * n - 1, n - 1, -n),
            np.arange(n - 1, 0, -1),
        ]
    )
    p, q = rim, np.roll(rim, -1)
    wall = np.concatenate([np.stack([p + n * n, q + n * n, q], 1), np.stack([p + n * n, q, p], 1)])
    shift = [0, 0, thickness / 2]
    return np.concatenate([side + shift, side - shift]), np.concatenate([top, top[:, ::-1] + n * n, wall])


def test_a_film_thinner_than_single_precision_is_refused(vibraverse, tmp_path):
    """Every other check takes it for a solid; the rays that give the sign meet its far side first."""
    vertices, faces = film(1e-7)
    judge(vertices, faces)
    assert Sampler(*film(1e-5)).occupancy(16).shape == (16, 16, 16)
    meshes.write_ply(tmp_path / "surface.ply", vertices, faces)
    products = run(vibraverse, tmp_path)
    refusals = [read_refusal(path) for path in products]
    assert refusals[0] == refusals[1]
    assert refusals[0].reason == "too_thin"
    assert refusals[0].advice


def test_occupancy_follows_the_cell_centres():
    found = Sampler(*shapes.ball(radius=0.9, subdivisions=5)).occupancy(16)
    radius = np.linalg.norm(mesh_grid(16), axis=-1)
    assert found[radius < 0.899].all()
    assert not found[radius > 0.9].any()
    fine = Sampler(*shapes.ball(radius=0.9, subdivisions=5)).signed_distance(48)
    # Three fine cells along each axis: the middle one's centre is the coarse centre.
    assert np.array_equal(found, fine[1::3, 1::3, 1::3] < 0)


def test_the_box_mesh_bounds_the_occupied_cells():
    occupied = Sampler(*shapes.ball(radius=0.7, subdivisions=4)).occupancy(16)
    vertices, faces = coarse_mesh(occupied)
    assert surfaces.topology(faces, len(vertices)).closed_manifold
    assert surfaces.volume(vertices, faces) == pytest.approx(occupied.sum() * (2 / 16) ** 3)
    assert np.allclose(vertices * 8, np.round(vertices * 8))
    assert np.array_equal(Sampler(vertices, faces).occupancy(16), occupied)
    assert len(np.unique(vertices, axis=0)) == len(vertices)


@pytest.mark.parametrize("cell", [(0, 0, 0), (3, 1, 2), (3, 3, 3)])
def test_the_box_mesh_of_one_cell_is_that_cell(cell):
    occupied = np.zeros((4, 4, 4), dtype=bool)
    occupied[cell] = True
    vertices, faces = coarse_mesh(occupied)
    assert (len(vertices), len(faces)) == (8, 12)
    assert np.allclose(vertices.mean(axis=0), cell_centres(4)[list(cell)])
    assert surfaces.volume(vertices, faces) == pytest.approx(0.5**3)


def test_a_body_too_thin_for_the_coarse_grid_keeps_one_cell():
    vertices, faces = shapes.box((1.8, 0.6, 0.01), centre=(0.0, 0.3, 0.0))
    assert not Sampler(vertices, faces).occupancy(16).any()
    distance = Sampler(vertices, faces).signed_distance(32)
    occupied = thickest_cell(distance, 16)
    assert occupied.sum() == 1
    centre = cell_centres(16)[np.argwhere(occupied)[0]]
    assert (np.abs(centre - [0, 0.3, 0]) < [0.95, 0.36, 0.07]).all()


def run(vibraverse, folder, name="grids", **options):
    import json

    products = folder / f"{name}.h5", folder / f"{name}.obj"
    status, _, errors = vibraverse(
        *("grids", "--object", "mine", "--surface", folder / "surface.ply"),
        *("--grids", products[0], "--coarse", products[1], "--options", json.dumps(options)),
    )
    assert status == 0, errors
    return products


def test_the_stage_writes_both_grids_and_the_box_mesh(vibraverse, tmp_path):
    vertices, faces = shapes.ball(subdivisions=3)
    meshes.write_ply(tmp_path / "surface.ply", vertices, faces)
    h5_path, obj = run(vibraverse, tmp_path, fine=32)
    with h5py.File(h5_path) as h5:
        occupied, distance = h5["occupancy"], h5["signed_distance"]
        assert (occupied.shape, occupied.dtype) == ((16, 16, 16), np.uint8)
        assert (distance.shape, distance.dtype) == ((32, 32, 32), np.float32)
        assert "1.8" in distance.attrs["unit"]
        assert "provenance" in h5.attrs
        assert np.array_equal(occupied[:], Sampler(vertices, faces).occupancy(16))
        assert np.array_equal(distance[:], Sampler(vertices, faces).signed_distance(32))
        count = int(occupied[:].sum())
    box = meshes.read_mesh(obj)
    assert surfaces.volume(box.vertices, box.faces) == pytest.approx(count * 0.125**3)
    again = run(vibraverse, tmp_path, "again", fine=32)
    assert [path.read_bytes() for path in again] == [h5_path.read_bytes(), obj.read_bytes()]


def test_the_stage_marks_a_cell_of_a_thin_body(vibraverse, tmp_path):
    meshes.write_ply(tmp_path / "surface.ply", *shapes.box((1.8, 1.0, 0.01)))
    h5_path, _ = run(vibraverse, tmp_path, fine=16)
    with h5py.File(h5_path) as h5:
        assert h5["occupancy"][:].sum() == 1


def test_distances_are_multiples_of_a_quantum_that_compresses():
    distance = Sampler(*shapes.ball(subdivisions=2)).signed_distance(16)
    assert np.array_equal(distance / grids.QUANTUM, np.round(distance / grids.QUANTUM))
    assert (distance != 0).all()
