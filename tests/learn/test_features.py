"""Features of the dataset's shards, their samples and the sides of the splits."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
import trimesh
from make_features import MATERIALS, OPTIONS, write, write_splits

import make_products
from vibraverse.cli import main
from vibraverse.contract.seeds import rng
from vibraverse.dataset import open as open_dataset
from vibraverse.dataset.schema import SPLIT_COLUMNS
from vibraverse.dataset.schema.tables import from_tsv
from vibraverse.learn.baselines.polynomials import polynomial_ritz
from vibraverse.learn.baselines.splines import spline_ritz
from vibraverse.learn.samples import Samples, at
from vibraverse.learn.sampling import UNIT, sample_surface
from vibraverse.learn.scaling import scaled, scaled_material, unit_hz, unscaled
from vibraverse.learn.sides import TooFew, sides

OBJECTS = [
    f"{family}-{number:04d}" for family in ("bar", "cup", "mug", "pan", "rod", "tin") for number in range(5)
]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The features of a small dataset, as the stage writes them."""
    results = tmp_path_factory.mktemp("features") / "results"
    make_products.build(results)
    for shard in ("0", "1"):
        arguments = (
            "--shard", results / f"dataset/shards/{shard}.h5", "--features", results / f"learn/features/{shard}",
            "--options", json.dumps({"points": 256, "view_px": 48, "poisson_nodes": 9}),
        )  # fmt: skip
        assert main(["features", *map(str, arguments)]) == 0
    return results


def test_the_stage_writes_what_the_dataset_holds(made):
    samples = at(made)
    assert samples.ids == ["ball-0000 solid", "bar-0000 solid", "bar-0000 hollow"]
    assert list(samples.family) == ["ball", "bar", "bar"]
    assert list(samples.materials) == sorted(make_products.MATERIAL_NAMES)
    with open_dataset(made / "dataset") as reader:
        for body, (object_, solidity) in enumerate(zip(samples.object, samples.solidity, strict=True)):
            place = {"object": object_, "solidity": solidity}
            stored = [reader.read("frequencies_hz", **place, material=name) for name in samples.materials]
            np.testing.assert_array_equal(samples.row("frequencies_hz", body), stored)
            pictures = samples.row("views", body)
            assert pictures.shape == (3, 48, 48, 3)
            assert abs(float(pictures.mean()) - float(reader.read("views", **place).mean())) < 1.0


def test_bodies_share_voxels_and_have_distances_of_their_own(made):
    """The hollow bar's differ from the solid one's inside alone, and both are those of their surfaces."""
    samples = at(made)
    assert samples.voxel_points == 32_768
    solid, hollow = 1, 2
    for name in ("voxels", "farthest"):
        np.testing.assert_array_equal(samples.row(name, solid), samples.row(name, hollow))
    with open_dataset(made / "dataset") as reader:
        np.testing.assert_array_equal(samples.row("voxels", solid), reader.read("occupancy", "bar-0000"))

    def box(places, sides):
        apart = np.abs(places) - sides / 2
        return np.linalg.norm(np.maximum(apart, 0), axis=-1) + np.minimum(apart.max(axis=-1), 0)

    sides = np.array([1.8, 0.4, 0.3])
    for body in (solid, hollow):
        places = UNIT * samples.row("distance_places", body)[:2].astype(float)
        expected = box(places, sides)
        if body == hollow:
            expected = np.maximum(expected, -box(places, 0.5 * sides))
        np.testing.assert_allclose(samples.row("distances", body), expected, rtol=1e-3, atol=1e-5)


def test_the_spectrum_and_the_frequencies_agree(made):
    """Material and size enter exactly, Poisson's ratio by interpolation."""
    samples = at(made)
    volume = samples.rows("volume_m3")
    for number, one in enumerate(samples.materials.values()):
        spectra = samples.rows("log_omega").astype(float)
        place = np.interp(one["poisson"], samples.poisson, np.arange(len(samples.poisson)))
        low = min(int(place), len(samples.poisson) - 2)
        at_ratio = (1 - place + low) * spectra[:, low] + (place - low) * spectra[:, low + 1]
        found = np.exp(at_ratio) * unit_hz(volume, one["young_pa"], one["density_kg_m3"])[:, None]
        np.testing.assert_allclose(found, samples.rows("frequencies_hz")[:, number], rtol=2e-4)


def test_ritz_frequencies_are_bounds_that_fall_with_the_unknowns(made):
    """And those of a ball and of a bar with its cavity are what the baselines find for one material."""
    samples = at(made)
    ritz = samples.rows("ritz").astype(float)
    assert samples.ritz_degrees == [4, 6, 8]
    assert samples.ritz_unknowns == [1000, 3000]
    assert (np.diff(ritz[:, :, :3], axis=2) < 1e-6).all()
    # Splines on fewer cells are no part of those on more, so single modes may rise by a little.
    assert (np.diff(ritz[:, :, 3:], axis=2) < 0.02).all()
    assert np.median(np.diff(ritz[:, :, 3:], axis=2)) < -0.01
    assert np.median(ritz[:, :, 4] - ritz[:, :, 2]) < -0.01
    poisson = float(samples.poisson[4])
    with open_dataset(made / "dataset") as reader:
        for body, prefix in ((0, "surface"), (2, "boundary")):
            place = {"object": str(samples.object[body]), "solidity": str(samples.solidity[body])}
            shape = [reader.read(f"{prefix}_{part}", **place) for part in ("vertices", "faces")]
            steel = {"young_pa": 2e11, "density_kg_m3": 7850.0, "poisson": poisson}
            unit = unit_hz(0.02**3 * trimesh.Trimesh(*shape).volume, 2e11, 7850.0)
            for number, method, size in ((1, polynomial_ritz, 6), (3, spline_ritz, 1000)):
                expected = method(*shape, steel, 0.02, size, ritz.shape[-1]).frequencies_hz
                rtol = 1e-5 if method is polynomial_ritz else 2e-3
                np.testing.assert_allclose(np.exp(ritz[body, 4, number]) * unit, expected, rtol=rtol)


def test_bodies_of_different_meshes_keep_their_tetrahedra(made):
    """In a frame of their own, of unit volume; distances tell that they are the same."""
    samples, sizes = at(made), set()
    with open_dataset(made / "dataset") as reader:
        for body, (object_, solidity) in enumerate(zip(samples.object, samples.solidity, strict=True)):
            stored, tets = (reader.read(f"tet_{part}", object_, solidity) for part in ("points", "cells"))
            points, cells, fields = samples.tetrahedra(body)
            assert len(points) == len(stored) == len(fields)
            sides = points[cells][:, 1:] - points[cells][:, :1]
            np.testing.assert_allclose(np.linalg.det(sides).sum() / 6, 1.0)
            assert (np.linalg.det(sides) > 0).all()
            assert (np.sort(cells) == np.sort(tets)).all()
            lengths = [np.linalg.norm(one - one[-1], axis=1)[:-1] for one in (points, stored)]
            np.testing.assert_allclose(lengths[0] / lengths[1], lengths[0][0] / lengths[1][0])
            sizes.add(len(points))
    assert len(sizes) > 1


def test_points_lie_on_the_surface_with_its_normals():
    ball = trimesh.creation.icosphere(4, 0.9)
    points = sample_surface(ball.vertices, ball.faces, 2000, rng("ball"))
    np.testing.assert_allclose(np.linalg.norm(points[:, :3], axis=1), 0.9, atol=2e-3)
    assert (np.einsum("ij,ij->i", points[:, :3], points[:, 3:]) > 0.89).all()
    assert np.abs(points[:, :3].mean(axis=0)).max() < 0.05  # uniform, in all octants


def test_scales_invert():
    frequencies = np.array([20.0, 440.0, 20_000.0, 31_000.0])
    np.testing.assert_allclose(unscaled(scaled(frequencies)), frequencies)
    np.testing.assert_allclose(scaled(np.array([20.0, 20_000.0])), [-1, 1])
    assert scaled(31_000.0) > 1  # not clipped
    np.testing.assert_allclose(scaled_material(500.0, 5e11, 0.25), [-1, 1, 0], atol=1e-12)


def test_samples_of_several_shards_are_one_table_and_travel_to_workers(tmp_path):
    folders = [write(tmp_path / "b", OBJECTS[15:]), write(tmp_path / "a", OBJECTS[:15])]
    samples = Samples(folders)
    assert len(samples) == 60
    assert list(samples.object[::2]) == sorted(OBJECTS)
    again = pickle.loads(pickle.dumps(samples))
    for body in (0, 31, 59):
        np.testing.assert_array_equal(samples.row("points", body), again.row("points", body))
        alone = Samples([write(tmp_path / f"alone-{body}", [str(samples.object[body])])])
        np.testing.assert_array_equal(alone.row("log_omega", body % 2), samples.row("log_omega", body))


def test_features_of_other_materials_are_refused(tmp_path):
    folders = [write(tmp_path / "a", OBJECTS[:2]), write(tmp_path / "b", OBJECTS[2:4])]
    record = json.loads((folders[1] / "features.json").read_text())
    (folders[1] / "features.json").write_text(
        json.dumps({**record, "materials": {"tin": MATERIALS["steel"]}})
    )
    with pytest.raises(ValueError, match="holds other materials than"):
        Samples(folders)
    with pytest.raises(FileNotFoundError, match="holds no features; make them"):
        at(tmp_path)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    return Samples([write(tmp_path_factory.mktemp("sides") / "0", [*OBJECTS, "own-0001"])])


def divided(samples, tmp_path, split: str, copies=None, **options):
    rows = from_tsv(
        write_splits(tmp_path / "splits.tsv", [*OBJECTS, "own-0001"], copies).read_text(), SPLIT_COLUMNS
    )
    return sides(samples, split, {row["object"]: row for row in rows}, 3, **options)


@pytest.mark.parametrize("split", ["object", "family-0", "family-1", "family-2", "shuffled-0", "shuffled-2"])
def test_every_body_is_on_one_side_with_its_twin(samples, tmp_path, split):
    found = divided(samples, tmp_path, split, hold_out=["files"])
    together = np.concatenate(list(found.values()))
    assert sorted(together) == list(range(len(samples)))
    of = {name: set(samples.object[bodies]) for name, bodies in found.items()}
    assert sum(map(len, of.values())) == len(OBJECTS) + 1
    assert of["held_out"] == {"own-0001"}


def test_a_family_is_tested_once_and_then_never_trained_on(samples, tmp_path):
    tested = []
    for fold in range(3):
        found = divided(samples, tmp_path, f"family-{fold}")
        families = set(samples.family[found["test"]])
        assert not families & set(samples.family[np.concatenate([found["train"], found["validation"]])])
        tested += families
    assert sorted(tested) == sorted(set(samples.family))


def test_an_object_is_tested_in_one_fold_of_the_shuffled_objects(samples, tmp_path):
    tested = [divided(samples, tmp_path, f"shuffled-{fold}")["test"] for fold in range(3)]
    assert sorted(np.concatenate(tested)) == list(range(len(samples)))
    assert all(len(set(samples.family[bodies])) > 3 for bodies in tested)  # families are mixed
    copied = divided(samples, tmp_path, "shuffled-1", copies={"tin-0002": "bar-0001"})
    side = {object_: name for name, bodies in copied.items() for object_ in samples.object[bodies]}
    assert side["tin-0002"] == side["bar-0001"]


def test_families_left_out_are_on_no_side_and_change_no_fold(samples, tmp_path):
    for split in ("object", "family-1", "shuffled-1"):
        whole = divided(samples, tmp_path, split)
        less = divided(samples, tmp_path, split, leave_out=["mug", "rod"])
        for side, bodies in whole.items():
            kept = [body for body in bodies if samples.family[body] not in ("mug", "rod")]
            np.testing.assert_array_equal(less[side], kept)


def test_a_copy_is_on_the_side_of_its_original(samples, tmp_path):
    for fold in range(3):
        found = divided(samples, tmp_path, f"family-{fold}", copies={"tin-0002": "bar-0001"})
        side = {object_: name for name, bodies in found.items() for object_ in samples.object[bodies]}
        assert side["tin-0002"] == side["bar-0001"]


def test_an_empty_side_is_one_sentence(tmp_path):
    few = Samples([write(tmp_path / "few", OBJECTS[:3])])
    rows = from_tsv(write_splits(tmp_path / "splits.tsv", OBJECTS[:3]).read_text(), SPLIT_COLUMNS)
    with pytest.raises(
        TooFew, match=r"of 3 objects leaves no body for validation; add objects, or raise the share"
    ):
        sides(few, "object", {row["object"]: row for row in rows}, 3)
    with pytest.raises(TooFew, match=r"lower learn.folds below 3: there are 1 families"):
        sides(few, "family-2", {row["object"]: row for row in rows}, 3)
    assert OPTIONS.points == 512
