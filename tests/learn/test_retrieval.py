"""Task ``retrieval``: its loss by hand, in several processes, after a signal; what it is told; what it refuses."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_features import write, write_splits  # noqa: E402
from toy_task import in_processes, same  # noqa: E402

from vibraverse.config.learn import Learn  # noqa: E402
from vibraverse.contract.errors import UsageError  # noqa: E402
from vibraverse.learn.baselines import correlations  # noqa: E402
from vibraverse.learn.baselines.rows import baselines  # noqa: E402
from vibraverse.learn.interruption import Interrupted  # noqa: E402
from vibraverse.learn.networks import towers  # noqa: E402
from vibraverse.learn.networks.dense import dense  # noqa: E402
from vibraverse.learn.pools import judge_retrieval  # noqa: E402
from vibraverse.learn.task import default_collate  # noqa: E402
from vibraverse.learn.tasks import samples_and_sides, task_of  # noqa: E402
from vibraverse.learn.tasks.retrieval import Retrieval  # noqa: E402
from vibraverse.learn.train import train  # noqa: E402

pytestmark = pytest.mark.learn
OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup", "mug") for number in range(10)]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Features of thirty objects, both bodies, and their splits; two objects are copies."""
    folder = tmp_path_factory.mktemp("retrieval")
    shard = write(folder / "00000", OBJECTS, invented_ritz=True)
    splits = write_splits(folder / "splits.tsv", OBJECTS, {"bar-0001": "bar-0000"})
    return [shard / "features.json"], splits


def options(model: str = "contrast", **training):
    chosen = {"steps": 8, "batch_size": 6, "validate_every": 4, "checkpoint_minutes": 60, **training}
    return Learn(preset="tiny", retrieval={"training": chosen}).run("retrieval", "object", model, 0)


def task_with(data, asked, kind=None):
    samples, sides = samples_and_sides(*data, asked)
    return kind(samples, sides, asked) if kind else task_of(samples, sides, asked)


def run(task, work):
    torch.set_num_threads(1)
    asked = task.options
    return train(task, asked.training, work, seed=0, facts={}, device="cpu", say=lambda line: None)


class Cloud(torch.nn.Module):
    """A shape tower that does not normalise over the batch, so that processes can share one without a GPU."""

    def __init__(self, known: int):
        super().__init__()
        self.each, self.known = dense(6, 16, 1, towers.WIDTH), torch.nn.Linear(known, towers.WIDTH)

    def forward(self, points, known):
        return self.each(points).amax(dim=1) + self.known(known)


class Clouds(Retrieval):
    """The task with a small shape tower."""

    def shape_tower(self):
        return Cloud(len(self.samples.materials))


def batch_of(task, places, split: str = "train"):
    dataset = task.dataset(split)
    return task.prepare(default_collate([dataset[0, place] for place in places]), torch.device("cpu"))


def by_hand(asked, wanted, left_out, scale: float) -> np.ndarray:
    """Return InfoNCE of rows (B, d) by its formula."""
    found = []
    for row in range(len(asked)):
        kept = [other for other in range(len(wanted)) if other == row or not left_out[row, other]]
        scores = np.array([scale * asked[row] @ wanted[other] for other in kept])
        found.append(np.log(np.exp(scores).sum()) - scale * asked[row] @ wanted[row])
    return np.array(found)


@pytest.mark.parametrize("symmetric", [False, True])
def test_the_loss_is_that_of_the_formula(symmetric):
    generator = torch.Generator().manual_seed(0)
    found = {
        name: torch.nn.functional.normalize(torch.randn(5, 4, generator=generator, dtype=torch.float64))
        for name in ("sound", "image", "shape")
    }
    pairs = [("sound", "image"), ("sound", "shape"), ("image", "shape")]
    alike = {pair: torch.rand(5, 5, generator=generator) < 0.3 for pair in pairs}
    alike = {pair: values | values.T for pair, values in alike.items()}
    loss = towers.contrast(found, found, 0, alike, torch.tensor(7.0), symmetric)
    expected = np.zeros(5)
    for one, other in pairs:
        parts = [by_hand(found[one].numpy(), found[other].numpy(), alike[one, other].numpy(), 7.0)]
        if symmetric:
            parts.append(by_hand(found[other].numpy(), found[one].numpy(), alike[one, other].numpy(), 7.0))
        expected += np.mean(parts, axis=0)
    np.testing.assert_allclose(loss.numpy(), expected, rtol=1e-6)


def test_what_is_right_is_no_negative(data):
    """Twins and copies are left out between pictures and others; between sound and shape a body in its material is."""
    task = task_with(data, options())
    at = {name: place for place, name in enumerate(task.ids("train"))}
    places = [at[name] for name in ("bar-0000 solid", "bar-0000 hollow", "bar-0001 solid", "bar-0002 solid")]
    batch = batch_of(task, places, "train")
    batch["material_number"] = torch.tensor([0, 0, 0, 0])
    alike = {pair: values.int().tolist() for pair, values in task._alike(batch).items()}
    look = [[1, 1, 1, 0], [1, 1, 1, 0], [1, 1, 1, 0], [0, 0, 0, 1]]
    assert alike["sound", "image"] == alike["image", "shape"] == look
    assert alike["sound", "shape"] == [[1, 0, 1, 0], [0, 1, 0, 0], [1, 0, 1, 0], [0, 0, 0, 1]]
    batch["material_number"] = torch.tensor([0, 0, 1, 0])
    assert not task._alike(batch)["sound", "shape"][0, 2]
    assert task_with(data, options("no_material"))._alike(batch)["sound", "shape"][0, 2]
    assert not any(values.any() for values in task_with(data, options("published"))._alike(batch).values())


def test_two_processes_give_what_one_gives(data, tmp_path):
    """Negatives come from both processes, so their losses and gradients are those of the whole batch."""
    asked = options(precision="float32")
    one = run(task_with(data, asked, Clouds), tmp_path / "one")

    def work(rank):
        two = run(task_with(data, asked, Clouds), tmp_path / "two")
        for name, weights in one.model.items():
            torch.testing.assert_close(two.model[name], weights, rtol=0, atol=1e-5)
        losses = [row["loss"] for row in one.curves]
        assert [row["loss"] for row in two.curves] == pytest.approx(losses, abs=1e-5)
        assert two.metrics["validation"] == pytest.approx(one.metrics["validation"], abs=1e-5)

    assert in_processes(work, 2, group=True) == [0, 0]


def test_half_a_training_and_its_rest_are_the_whole(data, tmp_path, monkeypatch):
    asked = options(steps=6, validate_every=3)
    whole = run(task_with(data, asked), tmp_path / "whole")
    halved, calls, losses = task_with(data, asked), [], Retrieval.losses

    def interrupted(self, model, batch):
        calls.append(1)
        if len(calls) == 4:
            os.kill(os.getpid(), signal.SIGTERM)
        return losses(self, model, batch)

    monkeypatch.setattr(Retrieval, "losses", interrupted)
    with pytest.raises(Interrupted):
        run(halved, tmp_path / "halves")
    rest = run(task_with(data, asked), tmp_path / "halves")
    assert len(calls) == 6
    same(whole, rest)


def test_the_scale_is_learnt_up_to_a_hundred_or_fixed(data):
    task = task_with(data, options())
    batch, model = batch_of(task, range(4)), task.model()
    assert model(batch)["scale"].item() == pytest.approx(1 / 0.07)
    with torch.no_grad():
        model.log_scale.fill_(9.0)
    assert model(batch)["scale"].item() == 100
    assert model.log_scale.requires_grad
    assert not task_with(data, options("published")).model().log_scale.requires_grad


@pytest.mark.parametrize("name", ["published", "contrast", "sized", "no_material"])
def test_what_each_tower_sees(data, name):
    """Material in the shape tower, but for the control; the size in `sized` alone; neither in the picture's."""
    task = task_with(data, options(name))
    assert task.kind == {"published": "published", "no_material": "control"}.get(name, "model")
    torch.manual_seed(0)
    model = task.model().eval()
    dataset = task.dataset("test", material=0)
    items = [dataset[0, place] for place in range(4)]
    other = [task.dataset("test", material=1)[0, place] for place in range(4)]
    larger = [{**item, "log_volume": item["log_volume"] + np.float32(1.0)} for item in items]
    seen = []
    with torch.no_grad():
        for some in (items, other, larger):
            found = model(task.prepare(default_collate(some), torch.device("cpu")))
            np.testing.assert_allclose(found["shape"].norm(dim=-1), 1, rtol=1e-5)
            seen.append(found)
    differs = [not torch.allclose(seen[0]["shape"], one["shape"], atol=1e-6) for one in seen[1:]]
    assert differs == [name != "no_material", name == "sized"]
    assert not torch.allclose(seen[0]["sound"], seen[1]["sound"], atol=1e-6)
    torch.testing.assert_close(seen[0]["image"], seen[1]["image"])


def test_a_spectrum_is_its_scale_and_its_pattern(data):
    """An octave higher, only the first number of a spectrum differs."""
    task = task_with(data, options())
    seen, model = [], task.model().sound
    model.head.register_forward_pre_hook(lambda module, inputs: seen.append(inputs[0]))
    heard = batch_of(task, range(3))["log_hz"]
    model(heard)
    model(heard + np.log(2.0))
    torch.testing.assert_close(seen[0][:, 1:], seen[1][:, 1:], atol=2e-4, rtol=0)
    assert ((seen[1] - seen[0])[:, 0] > 0.1).all()


def test_baselines_are_as_good_as_they_must_be(data):
    """Twelve tested bodies: chance and the material by hand; correlations beat chance, the spectrum of Ritz more."""
    task = task_with(data, options())
    found = {
        name: {row["measure"]: row["value"] for row in one.rows if row["source"] == "all"}
        for name, _, one in baselines(task)
    }
    assert list(found) == ["chance", "material oracle", "linear CCA", "finest Ritz, nearest spectrum"]
    count = len(task.sides["test"])
    assert count == 12
    assert found["chance"]["sound_to_shape_top_1"] == pytest.approx(1 / count)
    assert found["chance"]["sound_to_image_top_1"] == pytest.approx(2 / count)
    assert found["material oracle"]["sound_to_shape_top_1"] == pytest.approx(2 / count)
    for direction in ("sound_to_shape", "shape_to_sound"):
        chance, linear = (found[name][f"{direction}_mrr"] for name in ("chance", "linear CCA"))
        assert linear > 1.2 * chance
        # Its frequencies are the true ones, higher by a fifth: nearly all have the right one among the nearest.
        assert found["finest Ritz, nearest spectrum"][f"{direction}_mrr"] > 0.6
    assert found["finest Ritz, nearest spectrum"]["image_to_sound_mrr"] == pytest.approx(
        found["chance"]["image_to_sound_mrr"]
    )


def test_the_score_of_spectra_is_their_distance():
    random = np.random.default_rng(0)
    true, found = np.exp(random.normal(8, 1, size=(2, 5, 1, 6)))
    vectors = correlations.spectrum_match(true, found)
    scores = vectors["sound"][:, 0] @ vectors["shape"][:, 0].T
    distances = np.square(np.log(true[:, None, 0]) - np.log(found[None, :, 0])).sum(axis=-1)
    np.testing.assert_allclose(scores, -0.5 * distances, rtol=1e-9)


def test_answers_are_of_every_material(data):
    task = task_with(data, options())
    model = task.model()

    def predict(side, dataset):
        batch = task.prepare(
            default_collate([dataset[0, place] for place in range(len(dataset))]), torch.device("cpu")
        )
        with torch.no_grad():
            return {name: values.numpy() for name, values in task.predict(model.eval(), batch).items()}

    answers = task.answers("test", predict)
    assert {name: values.shape for name, values in answers.items()} == {
        "sound": (12, 2, 128), "image": (12, 1, 128), "shape": (12, 2, 128), "material": (12,),
    }  # fmt: skip
    assert answers["material"][::2].tolist() == answers["material"][1::2].tolist()  # both bodies of an object
    rows = task.judge(task.sides["test"], answers)
    assert {row["source"] for row in rows} == {"all", "one material"}
    held = judge_retrieval(
        task.samples, task.sides["test"][:6], {name: one[:6] for name, one in answers.items()}
    )
    assert held == [{"source": "all", "measure": "pool", "value": 6, "count": 6}]


def test_one_material_is_one_sentence(data, tmp_path):
    asked = options()
    samples, sides = samples_and_sides(*data, asked)
    samples.materials = {"steel": samples.materials["steel"]}
    with pytest.raises(UsageError, match=r"all bodies are of steel.*name two or more in `materials`"):
        task_of(samples, sides, asked)


def test_a_pool_of_fewer_than_ten_is_one_sentence(tmp_path):
    shard = write(tmp_path / "0", OBJECTS[:20], invented_ritz=True) / "features.json"
    splits = write_splits(tmp_path / "splits.tsv", OBJECTS[:20])
    with pytest.raises(UsageError, match=r"tests 8 bodies; among fewer than 10.*raise the share of test"):
        task_with(([shard], splits), options())


def test_presets_have_the_published_batch_and_a_larger_one():
    sizes = {
        (preset, model): Learn(preset=preset).run("retrieval", "object", model, 0).training.batch_size
        for preset in ("cpu", "small", "paper")
        for model in ("published", "contrast")
    }
    assert {sizes[preset, "published"] for preset in ("cpu", "small", "paper")} == {24}
    assert all(sizes[preset, "contrast"] >= 48 for preset in ("cpu", "small", "paper"))
    own = Learn(preset="cpu", retrieval={"training": {"batch_size": 32}})
    assert own.run("retrieval", "object", "published", 0).training.batch_size == 32
