"""Several processes through the stage ``train``: what one gives, after signals and kills too; nothing stays behind."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

from make_features import write, write_splits  # noqa: E402

from vibraverse.cli import main  # noqa: E402
from vibraverse.config.learn import RunOptions  # noqa: E402
from vibraverse.contract import products  # noqa: E402
from vibraverse.learn import launch  # noqa: E402
from vibraverse.learn.interruption import Interrupted  # noqa: E402

pytestmark = pytest.mark.learn
OBJECTS = [f"{family}-{number:04d}" for family in ("bar", "cup") for number in range(10)]
STEPS = 60


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> list[str]:
    """Features of twenty objects and their splits, as arguments."""
    folder = tmp_path_factory.mktemp("data")
    features, splits = write(folder / "00000", OBJECTS), write_splits(folder / "splits.tsv", OBJECTS)
    return ["--features", str(features), "--splits", str(splits)]


def arguments(data: list[str], folder: Path, processes: int, *more: str) -> list[str]:
    """Return the command of a training that writes a checkpoint after every step."""
    training = {"steps": STEPS, "batch_size": 8, "learning_rate": 1e-4, "checkpoint_minutes": 0}
    options = RunOptions(
        task="solidity", model="sound", split="object", preset="tiny", training=training,
        network={"width": 32, "layers": 2},
    )  # fmt: skip
    asked = options.model_dump_json()[:-1] + f', "processes": {processes}}}'
    outputs = {"--model": "model.pt", "--curves": "curves.csv", "--record": "training.json"}
    named = [word for flag, name in outputs.items() for word in (flag, str(folder / name))]
    return ["train", *data, *named, "--options", asked, *more]


class Attempt:
    """A stage with two processes that has taken some steps; its output is in ``log``."""

    def __init__(self, data: list[str], folder: Path, step: int | None):
        self.log, self.folder = folder.with_suffix(".log"), folder
        with open(self.log, "w") as log:
            command = [sys.executable, "-m", "vibraverse", *arguments(data, folder, 2)]
            self.stage = subprocess.Popen(command, stdout=log, stderr=log)
        while step is not None and self.step < step:
            assert self.stage.poll() is None, self.log.read_text()
            time.sleep(0.005)

    @property
    def step(self) -> int:
        """The step of the newest checkpoint."""
        found = self.folder.glob(".*/checkpoints/step-*")
        return max((int(path.name.removeprefix("step-")) for path in found), default=0)

    def process(self, rank: int) -> int:
        """Return the id of a process that trains."""
        of_rank = [
            process
            for process in working_on(self.folder)
            if f"\0RANK={rank}\0" in Path(f"/proc/{process}/environ").read_text()
        ]
        (process,) = of_rank
        return process

    def ended(self, status: int) -> str:
        """Wait for the end with an exit status, after which nothing may run; return the log."""
        assert self.stage.wait(300) == status, self.log.read_text()
        assert working_on(self.folder) == []
        return self.log.read_text()


def working_on(folder: Path) -> list[int]:
    """Return the processes that have a folder in their command."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if str(folder).encode() in path.read_bytes():
                found.append(int(path.parent.name))
        except (FileNotFoundError, ProcessLookupError):
            continue
    return found


def test_two_processes_survive_signals_and_kills_and_give_what_one_gives(data, tmp_path):
    assert main(arguments(data, tmp_path / "one", 1)) == 0
    folder = tmp_path / "two"

    attempt = Attempt(data, folder, 3)
    attempt.stage.send_signal(signal.SIGTERM)
    said = attempt.ended(1)
    found = re.search(r"vibraverse: SIGTERM ended training after step (\d+) of 60; a checkpoint is in", said)
    assert found, said
    stopped = int(found[1])
    assert attempt.step == stopped < STEPS

    attempt = Attempt(data, folder, stopped + 3)
    os.kill(attempt.process(1), signal.SIGKILL)
    said = attempt.ended(1)
    assert f"training goes on after step {stopped} of 60" in said
    assert (
        "vibraverse: process 2 of the 2 that trained together was killed (SIGKILL), probably for lack" in said
    )
    killed = attempt.step

    said = Attempt(data, folder, None).ended(0)
    assert f"training goes on after step {killed} of 60" in said
    assert sorted(path.name for path in folder.iterdir()) == ["curves.csv", "model.pt", "training.json"]
    one, two = (products.read_json(tmp_path / name / "training.json")["metrics"] for name in ("one", "two"))
    assert (one["processes"], two["processes"]) == (1, 2)
    assert (one["interruptions"], two["interruptions"]) == (0, 2)
    assert two["loss"] == pytest.approx(one["loss"], abs=1e-5)
    assert two["validation"] == pytest.approx(one["validation"], abs=1e-5)
    first, second = (torch.load(tmp_path / name / "model.pt", weights_only=True) for name in ("one", "two"))
    for part in ("best", "last"):
        for name, weights in first[part].items():
            torch.testing.assert_close(second[part][name], weights, rtol=1e-5, atol=1e-5)


def test_more_gpus_than_there_are_is_a_sentence(data, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert main(arguments(data, tmp_path, 1, "--gpus", "3")) == 1
    said = capfd.readouterr().err.splitlines()[-1]
    assert said.startswith("vibraverse: 3 processes on this host asked for, but PyTorch finds 2 GPUs here")
    assert "lower learn.gpus to 2" in said


def test_a_gpu_asked_for_is_trained_on(data, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert main(arguments(data, tmp_path, 1, "--gpus", "1")) == 1
    assert "a GPU is asked for, but PyTorch finds none" in capfd.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1])
def test_signals_go_to_all_processes(number):
    before = signal.getsignal(number)
    sleepers = [subprocess.Popen(["sleep", "60"]) for _ in range(2)]
    with launch._signals_passed_on(agent_of([one.pid for one in sleepers])) as caught:
        os.kill(os.getpid(), number)
        assert [one.wait(10) for one in sleepers] == [-number, -number]
        os.kill(os.getpid(), number)  # the processes are gone
    assert caught == [signal.Signals(number).name] * 2
    assert signal.getsignal(number) == before


def test_a_signal_before_the_processes_start_ends_the_training():
    said = "SIGTERM ended training before its first step; the same command starts it again"
    with pytest.raises(Interrupted, match=said), launch._signals_passed_on(agent_of([None, None])):
        os.kill(os.getpid(), signal.SIGTERM)


def agent_of(processes: list[int | None]):
    """Return a stand-in for the agent of some processes."""
    workers = [SimpleNamespace(id=process) for process in processes]
    return SimpleNamespace(get_worker_group=lambda: SimpleNamespace(workers=workers))
