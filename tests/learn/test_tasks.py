"""The tasks: networks that learn what can be learnt, physics that enters exactly, controls that learn nothing."""

from __future__ import annotations

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_features import write, write_splits  # noqa: E402

from vibraverse.cli import main  # noqa: E402
from vibraverse.config.learn import MODELS, Learn  # noqa: E402
from vibraverse.contract import products  # noqa: E402
from vibraverse.contract.errors import UsageError  # noqa: E402
from vibraverse.learn.baselines.statistics import BASELINES  # noqa: E402
from vibraverse.learn.evaluation import evaluate  # noqa: E402
from vibraverse.learn.networks.octree import rotations, turned  # noqa: E402
from vibraverse.learn.tasks import task_at  # noqa: E402
from vibraverse.learn.tasks.frequencies import between  # noqa: E402
from vibraverse.learn.tasks.solidity import PARTS  # noqa: E402
from vibraverse.learn.train import train  # noqa: E402

pytestmark = pytest.mark.learn
OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup", "mug", "pan", "rod") for number in range(8)]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Features of forty objects, both bodies, in two shards, and their splits."""
    folder = tmp_path_factory.mktemp("tasks")
    shards = [write(folder / "00000", OBJECTS[::2]), write(folder / "00001", OBJECTS[1::2])]
    return [shard / "features.json" for shard in shards], write_splits(folder / "splits.tsv", sorted(OBJECTS))


def options(task: str, model: str, split: str = "object", seed: int = 0, **training):
    """Return the options of a tiny training."""
    learn = Learn(preset="tiny", **{task: {"training": training}})
    return learn.run(task, split, model, seed)


def trained(data, tmp_path, asked):
    task = task_at(*data, asked)
    done = train(task, asked.training, tmp_path / "work", seed=asked.seed, facts={}, say=lambda line: None)
    return task, done


@pytest.mark.parametrize(
    ("task", "model"),
    # `subspace` has no labels to fit, and these bodies' spectra are not those of their tetrahedra. The tasks about
    # shapes have files of their own.
    [
        (task, model)
        for task, models in MODELS.items()
        for model in models
        if model != "subspace" and task not in ("reconstruction", "cavity")
    ],
)
def test_a_model_overfits_eight_samples(data, tmp_path, task, model, monkeypatch):
    """A network that cannot repeat eight bodies is built wrong; a control cannot, if it sees nothing that differs."""
    steps, rate = {
        "frequencies published": (200, 1e-3),
        "frequencies physics": (60, 3e-3),
        "frequencies ritz": (200, 3e-3),
        "retrieval published": (240, 3e-3),
        "retrieval contrast": (60, 3e-3),
        "retrieval sized": (60, 3e-3),
        "retrieval no_material": (60, 3e-3),
    }.get(f"{task} {model}", (120, 3e-3))
    asked = options(task, model, steps=steps, batch_size=8, learning_rate=rate, validate_every=0)
    made = task_at(*data, asked)
    # The hollow bodies here have the surfaces of the solid ones, and other spectra.
    eight = made.sides["train"][:: 2 if task == "frequencies" else 1][:8]
    made.sides = dict.fromkeys(made.sides, eight)
    fixed = type(made).dataset
    monkeypatch.setattr(made, "dataset", lambda split: fixed(made, "validation"))  # nothing is drawn
    before = evaluate(made, made.model().state_dict(), "train", asked.training)[0]
    done = train(made, asked.training, tmp_path / "work", seed=0, facts={}, say=lambda line: None)
    after = evaluate(made, done.model, "train", asked.training)[0]
    if task == "frequencies":
        assert after["median"] < {"published": 0.1, "physics": 0.01, "ritz": 0.01}[model] < before["median"]
    elif task == "retrieval":
        assert after["missed"] < 0.1 < before["missed"]
        assert after["top_1"] > 0.9
    elif model in ("image", "material"):
        assert after["accuracy"] == 0.5
    else:
        assert after["accuracy"] == 1.0


@pytest.mark.parametrize("model", ["physics", "ritz"])
def test_young_modulus_and_size_enter_exactly(data, model):
    """Four times E doubles every frequency, eight times the volume halves it, to rounding."""
    task = task_at(*data, options("frequencies", model))
    found, bodies = np.log(np.linspace(2, 9, 24))[None].repeat(2, axis=0), np.array([0, 1])
    once = task.hertz(found, bodies, 0)
    next(iter(task.samples.materials.values()))["young_pa"] *= 4
    np.testing.assert_allclose(task.hertz(found, bodies, 0), 2 * once, rtol=1e-14)
    volumes = task.samples.rows("volume_m3", bodies)
    task.samples.rows = lambda name, chosen: 8 * volumes
    np.testing.assert_allclose(task.hertz(found, bodies, 0), once, rtol=1e-14)


@pytest.mark.parametrize("name", ["physics", "ritz"])
def test_predicted_spectra_ascend(data, name):
    task = task_at(*data, options("frequencies", name))
    torch.manual_seed(0)
    model = task.model()
    torch.nn.init.normal_((model.head[-1] if name == "physics" else model.head.last).weight, std=0.3)
    _, found = evaluate(task, model.state_dict(), "test", task.options.training)
    assert (np.diff(found["found"], axis=1) >= 0).all()
    assert np.ptp(found["found"][:, 0]) > 0.02  # bodies differ


def test_an_untrained_physics_model_is_the_rescaled_mean(data):
    task = task_at(*data, options("frequencies", "physics"))
    mean = task.samples.rows("log_omega", task.sides["train"]).mean(axis=(0, 1))
    _, found = evaluate(task, task.model().state_dict(), "test", task.options.training)
    np.testing.assert_allclose(found["found"], np.broadcast_to(mean, found["found"].shape), atol=2e-3)


def test_an_untrained_ritz_model_removes_the_usual_error(data):
    task = task_at(*data, options("frequencies", "ritz"))
    samples, bodies = task.samples, task.sides["train"]
    usual = np.median(samples.rows("log_omega", bodies) - samples.rows("ritz", bodies)[:, :, -1], axis=(0, 1))
    _, found = evaluate(task, task.model().state_dict(), "test", task.options.training)
    poisson = next(iter(samples.materials.values()))["poisson"]
    tested = samples.rows("ritz", task.sides["test"])[:, :, -1]
    at = [[np.interp(poisson, samples.poisson, mode) for mode in body.T] for body in tested]
    np.testing.assert_allclose(found["found"], np.sort(np.array(at) + usual, axis=1), atol=1e-5)


def test_items_depend_on_seed_epoch_and_body_alone(data):
    for name, model in (("frequencies", "physics"), ("solidity", "informed")):
        first, again, other = (
            task_at(*data, options(name, model, seed=seed)).dataset("train") for seed in (0, 0, 1)
        )
        for key in ((0, 3), (5, 3)):
            one = first[key]
            for part, value in again[key].items():
                np.testing.assert_array_equal(one[part], value)
        differing = "points" if name == "frequencies" else "image"
        assert any((first[0, index][differing] != first[1, index][differing]).any() for index in range(8))
        assert any((first[0, index][differing] != other[0, index][differing]).any() for index in range(8))
        tested = task_at(*data, options(name, model)).dataset("test")
        np.testing.assert_array_equal(tested[0, 1][differing], tested[7, 1][differing])


def test_rotations_turn_bodies_and_keep_them_in_the_box():
    turns = rotations(torch.randn(50, 4, generator=torch.Generator().manual_seed(0)))
    torch.testing.assert_close(turns @ turns.mT, torch.eye(3).expand(50, 3, 3), atol=1e-6, rtol=0)
    torch.testing.assert_close(torch.linalg.det(turns), torch.ones(50))
    corners = torch.cartesian_prod(*[torch.tensor([-0.9, 0.9])] * 3)
    points = torch.cat([corners, torch.nn.functional.normalize(corners)], dim=-1).expand(50, 8, 6)
    moved = turned(points, turns)
    assert moved[..., :3].abs().max() < 1
    torch.testing.assert_close(moved[..., 3:].norm(dim=-1), torch.ones(50, 8))
    distances = torch.cdist(moved[..., :3], moved[..., :3])
    same = torch.cdist(corners, corners) / distances[:, :, :]
    assert (same[:, 0, 1:] / same[:, 0, 1:2] - 1).abs().max() < 1e-5  # one scale per body


def test_between_nodes_is_linear():
    nodes, values = torch.tensor([0.1, 0.2, 0.3]), torch.tensor([[[0.0], [1.0], [4.0]]]).expand(4, 3, 1)
    at = torch.tensor([0.1, 0.15, 0.25, 0.3])
    torch.testing.assert_close(between(nodes, values, at), torch.tensor([[0.0], [0.5], [2.5], [4.0]]))


def test_twins_look_alike_and_are_made_of_the_same(data):
    """Picture and material must not tell solid from hollow."""
    tested = task_at(*data, options("solidity", "published")).dataset("test")
    items = [tested[0, index] for index in range(len(tested))]
    for solid, hollow in zip(items[::2], items[1::2], strict=True):
        assert (solid["label"], hollow["label"]) == (0, 1)
        np.testing.assert_array_equal(solid["image"], hollow["image"])
        np.testing.assert_array_equal(solid["material"], hollow["material"])
        assert (solid["sound"] != hollow["sound"]).any()
    assert {name for parts in PARTS.values() for name in parts} <= set(items[0])


def test_a_dataset_without_hollow_bodies_is_one_sentence(tmp_path):
    shard = write(tmp_path / "0", OBJECTS[:10], solidities=("solid",)) / "features.json"
    splits = write_splits(tmp_path / "splits.tsv", OBJECTS[:10])
    with pytest.raises(
        UsageError, match=r"no object on the training side has both bodies.*write `solidities"
    ):
        task_at([shard], splits, options("solidity", "sound"))
    task_at([shard], splits, options("frequencies", "physics"))  # needs none


def test_splits_of_another_dataset_are_one_sentence(data, tmp_path):
    splits = write_splits(tmp_path / "splits.tsv", OBJECTS[:10])
    with pytest.raises(UsageError, match="features and splits are of different datasets"):
        task_at(data[0], splits, options("frequencies", "physics"))


def test_from_training_to_the_table(data, tmp_path, capsys):
    """Through the command line, as the rules call it; a second training of the same gives the same bytes."""
    evaluations = []
    features = [str(record.parent) for record in data[0]]
    for task, model in (
        ("frequencies", "physics"), ("frequencies", "published"), ("solidity", "sound"), ("retrieval", "contrast")
    ):  # fmt: skip
        asked = options(task, model, steps=8, warmup_steps=0, batch_size=4)
        folder = tmp_path / task / model
        arguments = ["--features", *features, "--splits", str(data[1]), "--options", asked.model_dump_json()]
        made = {
            name: str(folder / name) for name in ("model.pt", "curves.csv", "training.json", "metrics.json")
        }
        outputs = [
            "--model",
            made["model.pt"],
            "--curves",
            made["curves.csv"],
            "--record",
            made["training.json"],
        ]
        assert main(["train", *arguments, *outputs]) == 0
        inputs = ["--model", made["model.pt"], "--training", made["training.json"]]
        outputs = ["--answers", str(folder / "answers.npz"), "--record", made["metrics.json"]]
        assert main(["evaluate", *inputs, *arguments, *outputs]) == 0
        evaluations.append(made["metrics.json"])
        answers = np.load(folder / "answers.npz")
        assert len(answers["test/body"]) == 16  # eight objects, both bodies
    simple = []
    for task in MODELS:
        simple.append(str(tmp_path / task / "baselines.json"))
        asked = options(task, MODELS[task][0])
        arguments = ["--features", *features, "--splits", str(data[1]), "--options", asked.model_dump_json()]
        assert main(["baselines", *arguments, "--record", simple[-1]]) == 0
    table, record = tmp_path / "results.tsv", tmp_path / "results.json"
    outputs = ["--table", str(table), "--record", str(record)]
    assert main(["results", "--evaluations", *evaluations, "--baselines", *simple, *outputs]) == 0
    rows = products.read_json(record)["rows"]
    models = {(row["task"], row["model"]) for row in rows}
    assert models >= {("frequencies", "physics"), ("frequencies", "published"), ("solidity", "sound")}
    assert models >= {("frequencies", name) for name in BASELINES} | {("solidity", "logistic regression")}
    assert models >= {("retrieval", name) for name in ("contrast", "chance", "linear CCA")}
    medians = {row["model"]: row for row in rows if row["measure"] == "median" and row["source"] == "all"}
    median = medians["physics"]
    assert medians["mean spectrum"]["value"] < medians["training mean"]["value"]
    assert median["low"] <= median["value"] <= median["high"]
    assert median["preset"] == "tiny"
    accuracies = {
        row["model"]: row for row in rows if row["measure"] == "accuracy" and row["source"] == "all"
    }
    assert accuracies["sound"]["count"] == 16
    assert (
        accuracies["logistic regression"]["value"] > 0.9
    )  # the spectra of hollow bodies are wider, by the formula
    assert table.read_text().count("\n") == len(rows) + 1
    said = json.loads((tmp_path / "frequencies/physics/training.json").read_text())
    assert said["bodies"] == {"train": 56, "validation": 8, "test": 16, "held_out": 0}
