"""A training through a real Slurm, in the partition with stand-in GPUs, that Slurm tells to end."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from cluster_runs import CHAIN, QUICK, call, running, wait_for

from vibraverse.contract import products
from vibraverse.flow.paths import Paths
from workflow_runs import TINY, Run

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "learn"))
import make_features

OBJECTS = [f"bar-{number:04d}" for number in range(20)]
TRAINING = {"task": "solidity", "split": "object", "model": "sound", "seed": "0"}
CONFIG = {
    **TINY,
    "sources": {"generated": {"count": 20, "families": ["bar"]}, "bundled": [], "files": []},
    "dataset": {"shards": 1},
    "learn": {
        "preset": "tiny", "seeds": [0], "splits": ["object"], "tasks": ["solidity"],
        "solidity": {
            "models": ["sound"],
            "training": {"steps": 600, "batch_size": 8, "minutes": 60, "checkpoint_minutes": 0.005},
        },
    },
}  # fmt: skip
#: What stands for a GPU is none to PyTorch. So the job asks Slurm for one, and the training runs on the processor.
ON_STAND_IN = (
    "--set-resources", "train:slurm_partition=gpu", "train:gres=gpu:1", "train:mem_mb=2000", "train:runtime=10",
)  # fmt: skip


@pytest.fixture
def python(root) -> str:
    """The interpreter of an environment with PyTorch and the workflow."""
    if importlib.util.find_spec("torch"):
        return sys.executable
    found = root / ".venv-learn/bin/python"
    if not found.is_file():
        pytest.skip("there is no environment with PyTorch: `make learn`")
    return str(found)


def training(folder: Path, root: Path, python: str, profile: str) -> tuple[Run, Path, tuple[str, ...]]:
    """Return a run whose features exist, the record of its training, and the arguments that train and do no more."""
    folder.mkdir()
    run, paths = Run(folder, root, CONFIG, profile, python), Paths()
    shard = folder / paths.at(paths.features, shard="00000")
    shard.parent.mkdir(parents=True)
    make_features.write(shard, OBJECTS)
    (folder / paths.splits).parent.mkdir(parents=True)
    make_features.write_splits(folder / paths.splits, OBJECTS)
    record = paths.at(paths.training_record, **TRAINING)
    # One thread, because two that wait for each other take seconds a step on a busy machine.
    return run, folder / record, (record, "--allowed-rules", "train", "--set-threads", "train=1")


@pytest.mark.long
def test_a_training_that_slurm_ends_goes_on_and_gives_the_same(slurm, root, python, tmp_path):
    """As at its time limit, Slurm sends SIGTERM to every process of the job, shells included."""
    unbroken, expected, only = training(tmp_path / "unbroken", root, python, "default")
    unbroken(*only)
    run, record, only = training(tmp_path / "slurm", root, python, "slurm")
    process = run.start(*only, *QUICK[len(CHAIN) :], *ON_STAND_IN)
    job = wait_for(lambda: running("train"))[0]
    assert call("squeue", "-h", "-j", job, "-o", "%P %b").stdout.split() == ["gpu", "gres:gpu:1"]
    wait_for(lambda: list(record.parent.glob(".*/checkpoints/step-*")), 600)
    call("scancel", "--signal=TERM", job)
    wait_for(lambda: job not in running("train"), 600)
    assert not record.exists()
    log = run.folder / Paths().at(Paths().log("train", *TRAINING), **TRAINING)
    ended = log.read_text()
    assert process.wait(900) == 0
    assert "vibraverse: SIGTERM ended training after step " in ended
    step = int(ended.split("ended training after step ")[1].split()[0])
    assert 0 < step < 600
    assert f"training goes on after step {step} of 600" in log.read_text()
    made, same = products.read_json(record), products.read_json(expected)
    assert (made["metrics"]["interruptions"], same["metrics"]["interruptions"]) == (1, 0)
    for name in ("steps", "loss", "validation", "best"):
        assert made["metrics"][name] == same["metrics"][name]
