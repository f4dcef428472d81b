"""Task ``cavity``: the thickness of a wall is heard, and nothing else tells it."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_features import write, write_splits  # noqa: E402

from vibraverse.config.learn import Learn  # noqa: E402
from vibraverse.contract.errors import UsageError  # noqa: E402
from vibraverse.learn.baselines.rows import baselines  # noqa: E402
from vibraverse.learn.evaluation import answers  # noqa: E402
from vibraverse.learn.judging import judged  # noqa: E402
from vibraverse.learn.tasks import task_at  # noqa: E402
from vibraverse.learn.train import train  # noqa: E402

pytestmark = pytest.mark.learn
OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup", "mug", "pan") for number in range(10)]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Features of hollow bodies whose frequencies rise with t, the higher the mode the more."""
    folder = tmp_path_factory.mktemp("cavity")
    shard = write(folder / "0", OBJECTS, solidities=("hollow",), invented_ritz=True)
    hertz, t = np.load(shard / "frequencies_hz.npy"), np.load(shard / "thickness.npy")
    np.save(
        shard / "frequencies_hz.npy", hertz * (0.5 + t[:, None, None]) ** np.linspace(0.2, 1, hertz.shape[2])
    )
    return [shard / "features.json"], write_splits(folder / "splits.tsv", sorted(OBJECTS))


def asked(model: str, **training):
    return Learn(preset="tiny", cavity={"training": training}).run("cavity", "object", model, 0)


def error(rows: list[dict]) -> float:
    return next(row["value"] for row in rows if (row["source"], row["measure"]) == ("all", "t_error"))


def test_the_thickness_is_heard_and_not_seen(data, tmp_path):
    found = {}
    for model in ("sound", "outside"):
        task = task_at(*data, asked(model, steps=400, batch_size=16, learning_rate=3e-3, validate_every=50))
        done = train(task, task.options.training, tmp_path / model, seed=0, facts={}, say=lambda line: None)
        network = task.model()
        network.load_state_dict(done.best)

        def say(side, task=task, network=network):
            return answers(task, network, side, task.options.training)

        found[model] = error(judged(task, say).rows)
        assert task.kind == {"sound": "model", "outside": "control"}[model]
    simple = {name: error(one.rows) for name, _, one in baselines(task_at(*data, asked("sound")))}
    assert found["sound"] < 0.6 * found["outside"]
    assert simple["ridge regression"] < 0.6 * simple["training mean"]
    assert simple["training mean"] == pytest.approx(0.1, abs=0.04)  # t is even over 0.4


def test_a_model_knows_the_outside_alone(data):
    """And no number that the cavity changes, but the frequencies."""
    task = task_at(*data, asked("outside"))
    body = int(task.sides["train"][0])
    before = task.known(body, 0)
    assert before.shape == (6,)
    sound = task_at(*data, asked("sound"))
    assert sound.known(body, 0).shape == (6 + sound.samples.row("log_omega", 0).shape[-1],)
    np.testing.assert_array_equal(sound.known(body, 0)[:6], before)


def test_without_hollow_bodies_one_sentence(tmp_path):
    shard = write(tmp_path / "0", OBJECTS[:10], solidities=("solid",), invented_ritz=True) / "features.json"
    splits = write_splits(tmp_path / "splits.tsv", OBJECTS[:10])
    with pytest.raises(
        UsageError, match=r"no object on the training side has a hollow body; write `solidities"
    ):
        task_at([shard], splits, asked("sound"))
