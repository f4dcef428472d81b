"""The trainer: what it learns, repeats, refuses and says."""

from __future__ import annotations

import csv
import math
import os
import re
import signal

import numpy as np
import pytest

from vibraverse.contract.errors import NotThere, UsageError

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from torch.distributed.launcher.api import LaunchConfig, elastic_launch  # noqa: E402
from toy_task import SIZES, Toy, in_processes, options, run, same  # noqa: E402

from vibraverse.learn import curves, evaluation, optimisation, precision, ranks  # noqa: E402

pytestmark = pytest.mark.learn


def close(one: dict, other: dict, tolerance: float = 1e-5) -> None:
    for name in one:
        torch.testing.assert_close(one[name], other[name], rtol=tolerance, atol=tolerance)


def test_eight_samples_are_learned_by_heart(tmp_path):
    task = Toy({"train": 8, "validation": 8}, noise=0.0)
    task.dataset = lambda split, whole=task.dataset: whole("train")
    trained = run(tmp_path, task, steps=400, learning_rate=3e-2, validate_every=200, checkpoint_minutes=9)
    assert trained.metrics["validation"]["squared_error"] < 1e-5
    assert trained.metrics["loss"] < 1e-4


def test_the_same_seed_repeats_and_another_does_not(tmp_path):
    task = Toy(dropout=0.3)
    first = run(tmp_path / "1", task)
    same(first, run(tmp_path / "2", task))
    other = run(tmp_path / "3", task, seed=4)
    assert not torch.equal(first.model["0.weight"], other.model["0.weight"])


def test_workers_change_nothing(tmp_path):
    steps = {"steps": 9, "validate_every": 0}
    same(run(tmp_path / "0", **steps), run(tmp_path / "2", workers=2, **steps))


def test_a_killed_worker_is_a_failure_of_the_machine(tmp_path):
    class Hungry(Toy):
        def collate(self, items):
            os.kill(os.getpid(), signal.SIGKILL)

    said = r"a process that reads data was killed, probably for lack of memory; lower workers \(1\) or batch_size"
    with pytest.raises(NotThere, match=said):
        run(tmp_path, Hungry(), workers=1)


def test_two_processes_give_what_one_gives(tmp_path):
    """Under torchrun's own agent, with 13 samples to validate on: one process takes 7 of them, the other 6."""
    one = run(tmp_path / "one")
    config = LaunchConfig(
        min_nodes=1,
        max_nodes=1,
        nproc_per_node=2,
        rdzv_backend="c10d",
        rdzv_endpoint="localhost:0",
        start_method="fork",
        max_restarts=0,
        monitor_interval=0.1,
    )
    two = elastic_launch(config, run)(tmp_path / "two")
    assert sorted(two) == [0, 1]
    for trained in two.values():
        close(one.model, trained.model)
        close(one.best, trained.best)
        assert trained.metrics["processes"] == 2
        assert trained.metrics["validation"]["samples"] == SIZES["validation"]
        close_to = one.metrics["validation"]["squared_error"]
        assert trained.metrics["validation"]["squared_error"] == pytest.approx(close_to, abs=1e-5)
        losses = [row["loss"] for row in one.curves]
        assert [row["loss"] for row in trained.curves] == pytest.approx(losses, abs=1e-5)


def test_more_processes_than_samples_to_validate_on(tmp_path):
    def work(rank):
        trained = run(tmp_path, Toy({"validation": 1}), steps=2, validate_every=0)
        assert trained.metrics["validation"]["samples"] == 1

    assert in_processes(work, 2, group=True) == [0, 0]


def test_predictions_are_in_the_order_of_the_split():
    task = Toy()
    alone = ranks.Ranks(torch.device("cpu"))
    found = evaluation.predictions(task, task.model(), "test", options(batch_size=3), alone)
    expected = np.stack([item["x"] for item in task.dataset("test").items])
    np.testing.assert_array_equal(found["x"], expected)


def test_a_trained_network_is_evaluated_on_any_split(tmp_path):
    trained = run(tmp_path)
    metrics, found = evaluation.evaluate(Toy(), trained.best, "validation", options(), device="cpu")
    assert metrics == trained.metrics["best"]["validation"]
    assert len(found["x"]) == SIZES["validation"]
    metrics, _ = evaluation.evaluate(Toy(), trained.best, "test", options(), device="cpu")
    assert metrics["samples"] == SIZES["test"]


def test_the_best_weights_are_those_of_the_best_validation(tmp_path):
    class Worsening(Toy):
        def score(self, predictions):
            self.called = getattr(self, "called", 0) + 1
            return {"squared_error": [3.0, 1.0, math.nan, 2.0][self.called - 1]}

    trained = run(tmp_path / "whole", Worsening())
    assert (trained.metrics["best"]["step"], trained.metrics["validation"]) == (14, {"squared_error": 2.0})
    assert [row["validation"] for row in trained.curves if row["validation"]][:2] == [3.0, 1.0]
    assert not torch.equal(trained.best["0.weight"], trained.model["0.weight"])


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_loss_that_is_not_finite_names_its_samples(tmp_path, bad):
    class Broken(Toy):
        def dataset(self, split):
            data = super().dataset(split)
            if split == "train":
                data.items[5]["y"] = np.float32(bad)
            return data

    said = r"^step \d: the loss of some samples is not a finite number: train-005; look at these samples, or lower"
    with pytest.raises(UsageError, match=said):
        run(tmp_path, Broken())


def test_a_gradient_that_is_not_finite_names_its_batch(tmp_path):
    class Steep(Toy):
        def losses(self, model, batch):
            return torch.sqrt(super().losses(model, batch) * 0)

    said = r"step 1: the norm of the gradient, nan, of these samples is not a finite number: (train-\d\d\d(, )?){8};"
    with pytest.raises(UsageError, match=said):
        run(tmp_path, Steep())
    assert not list(tmp_path.glob("step-*"))


def test_a_loss_of_another_process_stops_all(tmp_path):
    class Broken(Toy):
        def losses(self, model, batch):
            bad = math.nan if os.environ["RANK"] == "1" and model.training else 0.0
            return super().losses(model, batch) + bad

    def work(rank):
        with pytest.raises(UsageError, match="step 1: the loss of some samples is not a finite number"):
            run(tmp_path, Broken())

    assert in_processes(work, 2, group=True) == [0, 0]


def test_one_loss_for_each_sample(tmp_path):
    class Mean(Toy):
        def losses(self, model, batch):
            return super().losses(model, batch).mean()

    with pytest.raises(TypeError, match=r"Mean.losses returned the shape \(\), not \(8,\)"):
        run(tmp_path, Mean())


def test_too_few_samples(tmp_path):
    said = (
        "batch_size is 8, but the split 'train' has 5 samples; lower batch_size to 5 or less, or add objects"
    )
    with pytest.raises(UsageError, match=said):
        run(tmp_path, Toy({"train": 5}))


@pytest.mark.parametrize("split", ["train", "validation"])
def test_an_empty_split(tmp_path, split):
    with pytest.raises(UsageError, match=f"the split '{split}' has no samples; add objects, or give"):
        run(tmp_path, Toy({split: 0}))


def test_a_batch_that_processes_cannot_share(tmp_path):
    def work(rank):
        with pytest.raises(UsageError, match="batch_size is 9, which 2 processes cannot share equally"):
            run(tmp_path, batch_size=9)

    assert in_processes(work, 2, group=True) == [0, 0]


def test_a_gpu_asked_for_and_not_there(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(NotThere, match="a GPU is asked for, but PyTorch finds none"):
        run(tmp_path, device="cuda")
    assert ranks.choose(None).type == "cpu"


def test_more_gpus_asked_for_than_there_are(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert ranks.choose(None) == torch.device("cuda:0")
    assert ranks.choose("cuda", local_rank=1) == torch.device("cuda:1")
    with pytest.raises(NotThere, match="the GPU cuda:3 asked for, but PyTorch finds 2 GPUs here"):
        ranks.choose("cuda:3")
    with pytest.raises(NotThere, match="3 processes on this host asked for, but PyTorch finds 2 GPUs here"):
        ranks.choose(None, local_rank=2)


def test_batch_statistics_are_shared_between_processes_on_gpus():
    several = ranks.Ranks(torch.device("meta"), 0, 2)
    layers = [type(layer) for layer in optimisation.placed(Toy(norm=True).model(), options(), several)]
    assert torch.nn.SyncBatchNorm in layers
    assert torch.nn.BatchNorm1d not in layers
    on_cpus = ranks.Ranks(torch.device("cpu"), 0, 2)
    with pytest.raises(UsageError, match="2 processes train on CPUs, where PyTorch cannot normalise"):
        optimisation.placed(Toy(norm=True).model(), options(), on_cpus)


def test_a_batch_of_one_has_no_spread(tmp_path):
    with pytest.raises(UsageError, match="batch_size is 1, and the network normalises over the batch"):
        run(tmp_path, Toy(norm=True), batch_size=1)


def test_bf16_is_near_float32_and_float64_stays_exact(tmp_path):
    class Exact(Toy):
        def losses(self, model, batch):
            product = batch["x"].double() @ batch["x"].double().T
            with precision.exact(batch["x"].device):
                assert (batch["x"] @ batch["x"].T).dtype == torch.float32
            assert product.dtype == torch.float64
            assert model[0](batch["x"]).dtype == torch.bfloat16
            return super().losses(model, batch)

    half, whole = run(tmp_path / "1", Exact(), precision="bf16"), run(tmp_path / "2")
    assert (half.metrics["precision"], whole.metrics["precision"]) == ("bf16", "float32")
    assert half.metrics["loss"] == pytest.approx(whole.metrics["loss"], rel=0.1)
    assert half.metrics["loss"] != whole.metrics["loss"]
    assert half.model["0.weight"].dtype == torch.float32


def test_auto_is_bf16_on_gpus_that_have_it(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_bf16_supported", lambda: True)
    assert precision.resolve("auto", torch.device("cuda")) == "bf16"
    assert precision.resolve("auto", torch.device("cpu")) == "float32"
    with precision.tf32(True):
        assert torch.backends.cuda.matmul.allow_tf32
    assert not torch.backends.cuda.matmul.allow_tf32


def test_learning_rates():
    def rates(**changes):
        given = options(learning_rate=1.0, **changes)
        return [optimisation.learning_rate(given, step) for step in range(given.steps)]

    assert rates(steps=4) == [1.0, 0.75, 0.5, 0.25]
    assert rates(steps=6, warmup_steps=2) == [0.5, 1.0, 1.0, 0.75, 0.5, 0.25]
    assert rates(steps=2, schedule="constant") == [1.0, 1.0]
    assert rates(steps=4, schedule="cosine") == pytest.approx(
        [1, (1 + 0.5**0.5) / 2, 0.5, (1 - 0.5**0.5) / 2]
    )


def test_the_clock_ends_training_with_what_was_reached(tmp_path):
    trained = run(tmp_path, minutes=1e-9)
    assert (trained.metrics["ended"], trained.metrics["steps"]) == ("minutes", 0)
    assert trained.metrics["validation"]["samples"] == SIZES["validation"]
    assert trained.best
    trained = run(tmp_path, minutes=0.02, steps=10**6, facts={}, checkpoint_minutes=9)
    assert trained.metrics["ended"] == "minutes"
    assert 0 < trained.metrics["steps"] < 10**6
    assert 1.2 <= trained.metrics["seconds"] < 20
    assert trained.curves[-1]["step"] == trained.metrics["steps"]


def test_metrics_say_on_what_and_how(tmp_path):
    metrics = run(tmp_path).metrics
    assert metrics["ended"] == "steps"
    assert (metrics["steps"], metrics["epochs"], metrics["seed"], metrics["processes"]) == (24, 4.8, 3, 1)
    assert metrics["samples"] == {"train": 40, "batch": 8}
    assert metrics["parameters"] == 4 * 16 + 16 + 16 + 1
    assert metrics["hardware"]["threads"] == 1
    assert metrics["hardware"]["cpu"]
    assert metrics["hardware"]["gpu"] is None
    assert metrics["versions"]["torch"] == str(torch.__version__)
    assert metrics["tf32"] is False
    assert metrics["interruptions"] == 0
    assert metrics["seconds"] > 0
    assert metrics["samples_per_s"] > 0
    assert 0 < metrics["waiting_share"] < 1


def test_curves_as_csv(tmp_path):
    trained = run(tmp_path)
    curves.write_csv(tmp_path / "curves.csv", trained.curves)
    with open(tmp_path / "curves.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == list(curves.COLUMNS)
    assert [int(row["step"]) for row in rows] == list(range(1, 25))
    assert [row["step"] for row in rows if row["validation"]] == ["7", "14", "21", "24"]
    assert float(rows[-1]["validation"]) == trained.metrics["validation"]["squared_error"]
    assert float(rows[0]["learning_rate"]) == 1e-2


def test_a_long_training_has_few_rows():
    kept = curves.Curves(5000)
    for step in range(1, 5001):
        kept.add(step, 0.1, float(step), 1.0, 8, 0.5, 0.125)
        if step == 1234:
            kept.validated(0.25)
    assert len(kept.rows) == 501
    assert kept.rows[0] == {
        "step": 10,
        "learning_rate": 0.1,
        "loss": 5.5,
        "gradient_norm": 1.0,
        "samples_per_s": 16.0,
        "waiting_share": 0.25,
        "validation": None,
    }
    assert [row["step"] for row in kept.rows[122:125]] == [1230, 1234, 1240]
    assert (kept.rows[123]["loss"], kept.rows[123]["validation"]) == (1232.5, 0.25)


def test_people_can_read_how_far_it_is(tmp_path, monkeypatch):
    from vibraverse.learn import progress

    lines = []
    run(tmp_path / "1", say=lines.append)
    assert lines[0].startswith("step 7 of 24: validation squared_error 0.")
    assert lines[0].endswith(" (best so far)")
    assert len(lines) == 4
    monkeypatch.setattr(progress, "INTERVAL_S", 0.0)
    run(tmp_path / "2", say=lines.append)
    assert re.fullmatch(
        r"step 1 of 24: loss [\d.]+, learning rate 0.01, [\d.e+]+ samples/s, \d+% of the time waiting for data, "
        r"(\d+ min )?\d+ s left",
        lines[4],
    )
