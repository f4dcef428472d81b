"""Task ``reconstruction``: the shape network, its samples, and what sound adds to voxels."""

from __future__ import annotations

import os
import resource
import signal
import time
from itertools import count

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_features import OPTIONS, box_of, write, write_splits  # noqa: E402
from toy_task import same  # noqa: E402

from vibraverse.config import ConfigError, validate  # noqa: E402
from vibraverse.config.learn import MODELS, Features, Learn, Network  # noqa: E402
from vibraverse.learn.baselines.rows import baselines  # noqa: E402
from vibraverse.learn.evaluation import answers  # noqa: E402
from vibraverse.learn.interruption import Interrupted  # noqa: E402
from vibraverse.learn.judging import judged  # noqa: E402
from vibraverse.learn.networks.shape_vae import ShapeVae, fourier  # noqa: E402
from vibraverse.learn.tasks import task_at  # noqa: E402
from vibraverse.learn.tasks.reconstruction import dimensionless  # noqa: E402
from vibraverse.learn.train import train  # noqa: E402

pytestmark = pytest.mark.learn
OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup") for number in range(10)]
SMALL = {
    "width": 64,
    "latents": 32,
    "encoder_blocks": 1,
    "decoder_blocks": 1,
    "voxel_points": 128,
    "distances": 256,
}


def with_cavity(object_: str, solidity: str):
    """Return the surface of an object's box; in a hollow one there is a box of half its sides."""
    vertices, faces = box_of(object_, solidity)
    if solidity == "hollow":
        return np.vstack([vertices, 0.5 * vertices]), np.vstack([faces, faces[:, ::-1] + len(vertices)])
    return vertices, faces


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Features of twenty boxes, solid and hollow, and their splits."""
    folder = tmp_path_factory.mktemp("reconstruction")
    shard = write(folder / "0", OBJECTS, surface=with_cavity, invented_ritz=True)
    return [shard / "features.json"], write_splits(folder / "splits.tsv", sorted(OBJECTS))


def options(model: str, seed: int = 0, network: dict | None = None, **training):
    given = {"warmup_steps": 0, "validate_every": 0, **training}
    learn = Learn(
        preset="tiny",
        features=OPTIONS,
        reconstruction={"training": given, "network": {**SMALL, **(network or {})}},
        frequencies={"network": {"points": 512}},
    )
    return learn.run("reconstruction", "object", model, seed)


def learned(task, work, **changes):
    asked = task.options.training.model_copy(update=changes)
    torch.set_num_threads(1)
    return train(task, asked, work, seed=0, facts={}, say=lambda line: None)


def asked(task, done) -> dict[str, np.ndarray]:
    model = task.model()
    model.load_state_dict(done.model)
    return answers(task, model, "test", task.options.training)


def test_the_published_network_has_its_published_size():
    """157 million parameters, and 2.3 TFLOP for a sample of training, as counted by the paper's description."""
    from torch.utils.flop_counter import FlopCounterMode

    network = Learn(preset="paper").run("reconstruction", "object", "published", 0).network
    with torch.device("meta"):
        model = ShapeVae(network, {"scaled": 64, "material": 3})
        sample = {
            "cloud": torch.empty(1, network.voxel_points, 6), "places": torch.empty(1, network.distances, 3),
            "scaled": torch.empty(1, 64), "material": torch.empty(1, 3),
        }  # fmt: skip
        with FlopCounterMode(display=False) as counter:
            found, divergence = model(sample)
            (found.mean() + divergence.mean()).backward()
    assert sum(weight.numel() for weight in model.parameters()) == pytest.approx(157e6, rel=0.01)
    assert counter.get_total_flops() == pytest.approx(2.3e12, rel=0.1)
    assert (len(model.encoder), len(model.decoder), network.latents, network.width) == (8, 12, 1024, 768)


def test_a_place_has_51_numbers():
    places = torch.tensor([[0.5, -0.25, 1.0]])
    found = fourier(places)[0].numpy()
    expected = [np.sin(0.5 * 128), np.cos(0.5 * 1), np.sin(-0.25)]
    assert found.shape == (51,)
    np.testing.assert_array_equal(found[:3], places[0])
    np.testing.assert_allclose([found[3 + 7], found[3 + 24], found[3 + 8]], expected, atol=1e-5)


def test_a_network_gives_a_place_the_same_value_whatever_the_others():
    torch.manual_seed(0)
    model = ShapeVae(Network(**{**SMALL, "cells": 8}), {"material": 3}).eval()
    batch = {"cloud": torch.randn(2, 128, 6), "material": torch.randn(2, 3), "places": torch.rand(2, 50, 3)}
    whole = model(batch)[0]
    part = model({**batch, "places": batch["places"][:, :7]})[0]
    torch.testing.assert_close(whole[:, :7], part, atol=1e-5, rtol=1e-5)
    other = model({**batch, "material": -batch["material"]})[0]
    assert (other - whole).abs().max() > 1e-4


def twins(task, object_: str) -> np.ndarray:
    """Return the numbers of an object's bodies, the solid one first."""
    return np.flatnonzero(task.samples.object == object_)


def test_an_object_is_overfitted_and_its_cavity_is_heard(data, tmp_path):
    """Both bodies to an IoU above 0.95 from the same voxels: a network that cannot repeat them is built wrong."""
    size = {
        "cells": 32,
        "distances": 512,
        "latents": 16,
        "voxel_points": 64,
        "encoder_blocks": 0,
        "decoder_blocks": 2,
    }
    task = task_at(
        *data,
        options("truncated", steps=900, batch_size=2, learning_rate=4e-3, warmup_steps=30, network=size),
    )
    task.sides = dict.fromkeys(task.sides, twins(task, "bar-0000"))
    found = asked(task, learned(task, tmp_path))
    assert (found["iou"] > 0.95).all()
    assert (found["volume_error"] < 0.05).all()  # the cavity is an eighth
    assert (found["band_error"] < 0.01).all()
    assert not found["empty"].any()
    rows = {(row["source"], row["measure"]): row for row in task.judge(task.sides["test"], found)}
    assert rows["all", "iou"]["value"] == pytest.approx(found["iou"].mean())
    assert rows["hollow", "iou"]["count"] == 1
    assert {"band_error", "chamfer", "f_1%", "f_2%", "normals", "frequency_error", "failed", "seconds"} <= {
        measure for _, measure in rows
    }


def test_controls_cannot_tell_twins_apart_and_the_others_can(data):
    """Voxels and material are the same; what is heard is not."""
    for model in MODELS["reconstruction"]:
        task = task_at(*data, options(model))
        torch.manual_seed(0)
        network = task.model().eval()
        task.sides = dict.fromkeys(task.sides, twins(task, "cup-0003"))
        items = task.dataset("test")
        batch = task.collate([items[0, 0], items[0, 1]])
        batch["places"][1] = batch["places"][0]
        np.testing.assert_array_equal(batch["cloud"][0], batch["cloud"][1])
        with torch.no_grad():
            solid, hollow = network(batch)[0]
        assert torch.equal(solid, hollow) == (model in ("material", "silent")), model
        assert (task.kind == "control") == (model in ("shuffled", "material", "silent"))


def test_shuffled_sound_is_that_of_another_object(data):
    own, other = (task_at(*data, options(model)) for model in ("truncated", "shuffled"))
    for side, epochs in (("train", 3), ("test", 1)):
        items, heard = own.dataset(side), other.dataset(side)
        objects = own.samples.object[own.sides[side]]
        for epoch in range(epochs):
            for index in range(len(items)):
                true, false = items[epoch, index], heard[epoch, index]
                at = np.flatnonzero(
                    [
                        any(
                            np.array_equal(dimensionless(own.samples, body, number), false["heard"])
                            for number in (0, 1)
                        )
                        for body in own.sides[side]
                    ]
                )
                assert len(at) == 1
                assert objects[at[0]] != objects[index]
                np.testing.assert_array_equal(true["true"], false["true"])


def test_what_is_heard_does_not_tell_the_size_or_the_stiffness(data):
    """Of a body twice as long, of another metal with the same Poisson's ratio."""
    samples = task_at(*data, options("truncated")).samples
    before = dimensionless(samples, 3, 0)
    material = next(iter(samples.materials.values()))
    rows = {"size_m": np.float64(0.2), "frequencies_hz": samples.row("frequencies_hz", 3) / 2 * 3}
    material["young_pa"] *= 9
    try:
        samples.row = lambda name, body: rows[name]
        np.testing.assert_allclose(dimensionless(samples, 3, 0), before, atol=1e-6)
    finally:
        material["young_pa"] /= 9


def test_samples_are_drawn_in_training_alone(data):
    task = task_at(*data, options("truncated"))
    trained, tested = task.dataset("train"), task.dataset("test")
    for name in ("places", "cloud"):
        assert (trained[0, 0][name] != trained[1, 0][name]).any()
        np.testing.assert_array_equal(trained[1, 0][name], task.dataset("train")[1, 0][name])
        np.testing.assert_array_equal(tested[0, 0][name], tested[5, 0][name])
    item = trained[0, 1]
    assert item["places"].shape == (256, 3)
    near = np.abs(item["true"]) < 0.1
    assert near[128:].mean() > 0.8 > 0.5 > near[:128].mean()  # the second half is near the surface
    np.testing.assert_array_equal(  # the farthest points stay in front
        trained[0, 0]["cloud"][:32], trained[1, 0]["cloud"][:32]
    )
    published = task_at(*data, options("published")).dataset("train")[0, 1]
    assert (np.abs(published["true"]) < 0.1).mean() < 0.5


def test_half_a_training_and_its_continuation_are_the_whole(data, tmp_path):
    task = task_at(*data, options("truncated", steps=6, batch_size=2, checkpoint_minutes=0))
    whole = learned(task, tmp_path / "whole")
    broken = task_at(*data, options("truncated", steps=6, batch_size=2, checkpoint_minutes=0))
    calls, losses = count(1), broken.losses

    def interrupted(model, batch):
        if next(calls) == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        return losses(model, batch)

    broken.losses = interrupted
    with pytest.raises(Interrupted):
        learned(broken, tmp_path / "broken")
    broken.losses = losses
    same(learned(broken, tmp_path / "broken"), whole)


def test_voxels_are_judged_like_models(data):
    task = task_at(*data, options("published", network={"cells": 16}))
    task.sides = {side: bodies[:4] for side, bodies in task.sides.items()}
    found = {name: judgement for name, _, judgement in baselines(task)}
    assert list(found) == ["coarse voxels", "smoothed voxels"]
    rows = {row["measure"]: row for row in found["coarse voxels"].rows if row["source"] == "solid"}
    assert rows["iou"]["value"] > 0.7  # a box is nearly its cells
    assert rows["iou"]["low"] <= rows["iou"]["value"] <= rows["iou"]["high"]
    assert rows["failed"]["value"] == rows["empty"]["value"] == 0
    hollow = {row["measure"]: row for row in found["coarse voxels"].rows if row["source"] == "hollow"}
    assert hollow["iou"]["value"] < rows["iou"]["value"]


def test_an_untrained_network_without_a_surface_is_counted_and_not_an_error(data):
    task = task_at(*data, options("truncated", network={"cells": 12}))
    task.sides = {side: bodies[:2] for side, bodies in task.sides.items()}
    model = task.model()
    torch.nn.init.zeros_(model.network.last[1].weight)
    torch.nn.init.ones_(model.network.last[1].bias)  # outside everywhere
    found = judged(task, lambda side: answers(task, model, side, task.options.training))
    values = {row["measure"]: row["value"] for row in found.rows if row["source"] == "all"}
    assert (values["empty"], values["failed"], values["iou"], values["frequency_error"]) == (1, 1, 0, 1)
    assert "chamfer" not in values
    assert all(np.isfinite(value) for value in values.values())


def test_one_material_is_enough(data, tmp_path):
    task = task_at(*data, options("truncated", steps=2, batch_size=2))
    task.samples.materials = dict(list(task.samples.materials.items())[:1])
    assert np.isfinite(learned(task, tmp_path).metrics["loss"])


@pytest.mark.parametrize(
    ("network", "features", "said"),
    [
        ({"width": 100}, {}, "width is 100; make it a multiple of 64"),
        ({"latents": 4096}, {}, "latents: the network asks for 4096.*network.voxel_points is"),
        (
            {"latents": 500, "voxel_points": 2000},
            {"farthest": 64},
            "asks for 500, and learn.features.farthest is 64",
        ),
        (
            {"voxel_points": 40_000},
            {},
            "asks for 40000, and learn.features.voxel_points is 32768; lower the first",
        ),
        ({"distances": 20_000}, {}, "asks for 20000, and learn.features.distance_samples is 16384"),
        ({}, {"farthest": 4000, "voxel_points": 3000}, "4000 of 3000 voxel_points cannot be chosen"),
    ],
)
def test_a_network_that_the_features_cannot_feed_is_one_sentence(network, features, said):
    with pytest.raises(ConfigError, match=said):
        validate(Learn, {"preset": "tiny", "features": features, "reconstruction": {"network": network}})


@pytest.mark.skipif(
    "VIBRAVERSE_PUBLISHED" not in os.environ, reason="takes 4 GB and minutes; set VIBRAVERSE_PUBLISHED"
)
def test_the_published_network_takes_a_step_on_a_processor(tmp_path):
    shard = write(
        tmp_path / "0",
        OBJECTS[:10],
        options=Features(points=512, poisson_nodes=5, ritz_degrees=[2], ritz_unknowns=[300], view_px=32),
        invented_ritz=True,
    )
    splits = write_splits(tmp_path / "splits.tsv", OBJECTS[:10])
    paper = Learn(preset="paper", reconstruction={"training": {"steps": 1, "batch_size": 1, "workers": 0}})
    task = task_at([shard / "features.json"], splits, paper.run("reconstruction", "object", "published", 0))
    task.sides = {side: bodies[:1] for side, bodies in task.sides.items()}
    began, done = time.process_time(), learned(task, tmp_path / "work")
    print(
        f"{time.process_time() - began:.0f} CPU s, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB"
    )
    assert np.isfinite(done.metrics["loss"])
    assert done.metrics["parameters"] == pytest.approx(157e6, rel=0.01)
