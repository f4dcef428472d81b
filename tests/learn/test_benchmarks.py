"""The benchmarks of training: they end in time, and measure what they say."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is not installed (it belongs to the learning environment)")

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
sys.path.append(str(BENCHMARKS))  # behind the tests, whose modules may have the same names

import gpu  # noqa: E402
import gpu_parts  # noqa: E402
import growth  # noqa: E402
import loader  # noqa: E402
import synthetic  # noqa: E402

from vibraverse.config.learn import Features  # noqa: E402

pytestmark = pytest.mark.learn


@pytest.fixture(scope="module")
def setting(tmp_path_factory) -> gpu_parts.Setting:
    folder = tmp_path_factory.mktemp("benchmark")
    synthetic.write(folder / "features", 24, Features(points=512, view_px=32))
    return gpu_parts.Setting("cpu", "tiny", folder / "features", folder, 2.0, 1)


def test_labels_are_exact(setting):
    found = {name: value for part in gpu_parts.labels(setting) for name, value in part.items()}
    assert found["exact"]
    assert 0 < found["difference"] < 1e-9
    assert found["compared"] == found["batch"] == 64
    assert found["device_per_s"] > found["cpu_per_s"]  # batches pay on the processor, too


def test_lobpcg_finds_what_the_eigensolver_finds(setting):
    found = {name: value for part in gpu_parts.lobpcg(setting) for name, value in part.items()}
    assert found["converged"]
    assert found["difference"] < 1e-5


def test_a_slow_loader_is_measured_as_slow(setting, tmp_path):
    """Samples that take 10 ms each are 100 a second, and training waits for them."""
    task = synthetic.task(setting.features, "solidity", "sound", "tiny", steps=5, validate_every=0)
    data = type(task).dataset

    def slow(split: str):
        samples = data(task, split)
        draw = samples.draw
        samples.draw = lambda item, random: time.sleep(0.01) or draw(item, random)
        return samples

    fast = loader.rate(task, 0.2, "cpu")
    task.dataset = slow
    assert 30 < loader.rate(task, 0.5, "cpu") < 100 < fast
    _, waiting = loader.trained(task, tmp_path, "cpu")
    assert waiting > 0.3


def test_a_part_that_hangs_is_killed_and_keeps_what_it_found(setting):
    def part(_):
        yield {"first": 1}
        time.sleep(60)
        yield {"second": 2}

    found = gpu._watched("hangs", part, setting, 1.0)
    assert (found["first"], found["ended"]) == (1, "killed after 1 s")
    assert "second" not in found
    assert found["took_s"] < 10


def test_a_share_of_the_objects_keeps_families_and_a_share_of_the_families_keeps_objects():
    names = [f"{family}-{number}" for family in ("bar", "cup", "mug", "pan") for number in range(6)]
    samples = SimpleNamespace(
        object=np.repeat(names, 2), family=np.repeat([name.split("-")[0] for name in names], 2)
    )
    bodies = np.arange(2, 48)  # of the first family five objects
    half = growth.kept(samples, bodies, 0, "object", 0.5)
    assert {family: int((samples.family[half] == family).sum()) for family in set(samples.family)} == {
        "bar": 4, "cup": 6, "mug": 6, "pan": 6,
    }  # fmt: skip
    assert (np.unique(samples.object[half], return_counts=True)[1] == 2).all()  # twins stay together
    some = growth.kept(samples, bodies, 0, "family", 0.5)
    counts = dict(zip(*np.unique(samples.family[some], return_counts=True), strict=True))
    assert len(counts) == 2
    assert all(count == (10 if family == "bar" else 12) for family, count in counts.items())
    np.testing.assert_array_equal(growth.kept(samples, bodies, 3, "object", 1.0), bodies)


def test_invented_bodies_are_closed_and_differ():
    from vibraverse.learn.invariants import invariants

    found = [
        invariants(*synthetic._smooth(one, solidity))
        for one in ("bar-0000", "cup-0001")
        for solidity in ("solid", "hollow")
    ]
    for one, solid, hollow in (("bar", *found[:2]), ("cup", *found[2:])):
        assert hollow[3] > 1.2 * solid[3], one  # more area for less volume
    assert abs(found[0] / found[2] - 1).max() > 0.05


def test_the_whole_ends_in_time(tmp_path):
    command = [
        sys.executable, str(BENCHMARKS / "gpu.py"), "--minutes", "0.7", "--device", "cpu", "--preset", "tiny",
        "--objects", "24", "--models", "solidity:sound", "--out", str(tmp_path),
    ]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=120)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "results.json").read_text())
    assert list(found["parts"]) == ["data", "labels", "lobpcg", "train solidity:sound", "loader", "together"]
    assert found["seconds"] < 0.7 * 60 + 3
    assert found["parts"]["data"]["bodies"] == 48
    table = (tmp_path / "table.md").read_text()
    assert table.count("\n| ") == 8
    assert table.strip() in done.stdout


def test_nothing_that_the_parts_import_loads_the_driver():
    """A process that has loaded CUDA's driver cannot fork children that use it."""
    program = (
        "import gpu, importlib, torch\n"
        "def load(): raise SystemExit('the driver is loaded')\n"
        "torch._C._cuda_getDeviceCount = load\n"
        "torch._C._cuda_init = load\n"
        "for module in gpu._IMPORTED: importlib.import_module(module)\n"
        "try: torch.cuda.is_available()\n"
        "except SystemExit: print('the trap works')\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout) == (0, "the trap works\n"), done.stderr
