"""Kill, full disk, read-only folder: nothing half-written, one sentence, and the same command resumes."""

from __future__ import annotations

import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import make_products
from vibraverse.contract import journal, products
from vibraverse.flow.paths import Paths
from vibraverse.flow.plan import Plan
from vibraverse.flow.targets import shard_products
from workflow_runs import Run, kill_when

#: How often whole runs are killed while a random job works; some 10 s each.
KILLS = int(os.environ.get("VIBRAVERSE_KILLS", "0"))


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Paths:
    """The products of a ball, a bar and a leaf."""
    return make_products.build(tmp_path_factory.mktemp("accidents") / "results")


def command(paths: Paths, shard: Path) -> list[str]:
    """Return the command that packs two objects."""
    options = make_products.options(paths.results, ["ball-0000", "bar-0000"])
    return [sys.executable, "-m", "vibraverse", "dataset", "--shard", str(shard), "--options", options]


def pack(paths: Paths, shard: Path) -> subprocess.CompletedProcess:
    return subprocess.run(command(paths, shard), capture_output=True, text=True)


@pytest.fixture(scope="module")
def right(made, tmp_path_factory) -> str:
    """The checksum of the undisturbed shard; its name is in its rows."""
    shard = tmp_path_factory.mktemp("right") / "0.h5"
    assert pack(made, shard).returncode == 0
    return products.sha256(shard)


def partial_of(folder: Path, size: float) -> Callable[[], bool]:
    """Return a function that tells whether a partial file in a folder is non-empty."""
    return lambda: any(path.stat().st_size >= size for path in folder.glob(".*.partial.*"))


def test_a_shard_killed_at_random_moments_is_whole_or_not_there(made, right, tmp_path):
    draw, killed = random.Random(6), 0
    shard = tmp_path / "shards/0.h5"
    assert pack(made, shard).returncode == 0
    size = shard.stat().st_size
    for _ in range(20):
        shard.unlink(missing_ok=True)
        process = subprocess.Popen(command(made, shard), stderr=subprocess.DEVNULL, start_new_session=True)
        killed += kill_when(process, partial_of(shard.parent, draw.uniform(0, 0.9) * size))
        assert not shard.exists() or products.sha256(shard) == right
    assert killed >= 10
    shard.unlink(missing_ok=True)
    assert pack(made, shard).returncode == 0
    assert products.sha256(shard) == right
    assert [path.name for path in shard.parent.iterdir()] == ["0.h5"]


@pytest.mark.parametrize("size", ["40k", "200k", "600k"])
def test_a_full_disk_leaves_nothing_and_one_sentence(made, right, small_disk, size):
    shard = small_disk(f"size={size}") / "0.h5"
    done = pack(made, shard)
    assert done.returncode == 1
    # HDF5 may say more before.
    assert done.stderr.splitlines()[-1] == (
        f"vibraverse: dataset: {shard} cannot be written: No space left on device; free some space, then repeat "
        "the command."
    )
    assert list(shard.parent.iterdir()) == []
    small_disk("size=100m", remount=True)
    assert pack(made, shard).returncode == 0
    assert products.sha256(shard) == right


def test_a_full_disk_keeps_the_product_of_before(made, small_disk):
    shard = small_disk("size=100m") / "0.h5"
    assert pack(made, shard).returncode == 0
    before = products.sha256(shard)
    small_disk(f"size={shard.stat().st_size // 1024 + 200}k", remount=True)
    assert pack(made, shard).returncode == 1
    assert products.sha256(shard) == before
    assert [path.name for path in shard.parent.iterdir()] == ["0.h5"]


def test_a_read_only_folder_is_one_sentence(made, small_disk):
    place = small_disk("size=100m")
    for shard in (place / "0.h5", place / "new/folder/0.h5"):
        small_disk("ro", remount=True)
        done = pack(made, shard)
        assert done.returncode == 1
        assert done.stderr.splitlines()[-1] == (
            f"vibraverse: dataset: {shard} cannot be written: Read-only file system; make it writable, or choose "
            "another results folder, then repeat the command."
        )
        assert list(place.iterdir()) == []
    small_disk("rw", remount=True)
    assert pack(made, place / "0.h5").returncode == 0


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_the_right_to_write_is_one_sentence(made, tmp_path):
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o555)
    done = pack(made, folder / "0.h5")
    assert done.returncode == 1
    assert "cannot be written: Permission denied; make it writable" in done.stderr.splitlines()[-1]


def test_an_input_that_may_not_be_read_is_not_taken_for_a_full_disk(tmp_path):
    assert products.not_stored(FileNotFoundError(2, "No such file", "x"), "y") == ""
    assert products.not_stored(ValueError("errno = 2"), "y") == ""
    assert products.not_stored(OSError("write failed: errno = 28, error message"), "y").startswith(
        "y cannot be"
    )


def test_new_objects_touch_only_their_shards():
    """Add ten objects to 300: the other shards keep parameters and inputs, and only changes of these rerun them."""
    config = {"sources": {"generated": {"count": 300}, "bundled": []}, "dataset": {"shards": 64}}
    before = Plan(config)
    config["sources"]["generated"]["count"] = 310
    after = Plan(config)
    new = set(after.objects) - set(before.objects)
    assert len(new) == 10
    touched = {after.shard_of(object_id) for object_id in new}
    assert len(touched) < 11
    for shard in after.shards:
        same = before.options("dataset", shard=shard) == after.options("dataset", shard=shard)
        assert same == (shard not in touched)
        assert (shard_products(before, shard) == shard_products(after, shard)) == (shard not in touched)


def copied(finished: Run, folder: Path, results: Path | None = None) -> Run:
    """Return a run in ``folder`` with everything of the finished one except the dataset and later products."""
    results = results or folder / "results"
    shutil.copytree(finished.folder / "results", results, dirs_exist_ok=True)
    shutil.copytree(finished.folder / ".snakemake", folder / ".snakemake")
    for name in ("dataset", "report"):
        shutil.rmtree(results / name)
    (results / "verdict.json").unlink()
    return Run(folder, finished.root)


def test_a_run_killed_while_it_writes_shards(finished, tmp_path):
    run = copied(finished, tmp_path)
    (shard,) = (finished.folder / "results/dataset/shards").glob("*.h5")
    written = partial_of(tmp_path / "results/dataset/shards", 0.3 * shard.stat().st_size)
    assert kill_when(run.start(), written)
    run()
    assert run.checksums() == finished.checksums()
    assert not list((tmp_path / "results").rglob(".*.partial.*"))


#: A job that works until it is killed.
JOB = """
import time
from vibraverse.contract import journal
journal.begin("dataset", "00001", "")
time.sleep(600)
"""


def test_a_run_waits_for_a_job_that_a_killed_one_left(finished, tmp_path):
    run = copied(finished, tmp_path)
    record = tmp_path / "results/dataset/dataset.json"
    environment = {**run.environment, journal.RUN: "results/journal/runs/gone.json"}
    job = subprocess.Popen([sys.executable, "-c", JOB], cwd=tmp_path, env=environment)
    while not list(journal.begun(tmp_path / "results")):
        time.sleep(0.05)
    with subprocess.Popen(
        run.command(), env=run.environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            said = next(line for line in process.stdout if "whose run was killed" in line)
            assert f"dataset of 00001 is still computed by process {job.pid}" in said
            assert f"To end it: `kill {job.pid}`" in said
            time.sleep(3)
            assert not record.exists()
        finally:
            job.kill()
            job.wait()
        process.stdout.read()
        assert process.wait() == 0
    assert run.checksums() == finished.checksums()


@pytest.mark.skipif(not KILLS, reason="VIBRAVERSE_KILLS is not set")
def test_runs_killed_at_random_moments_end_like_an_undisturbed_one(finished, tmp_path):
    draw, killed, runs = random.Random(20), 0, 0
    while killed < KILLS:
        runs += 1
        run = Run(tmp_path / str(runs), finished.root)
        run.folder.mkdir()
        before = killed
        while killed < KILLS and not (run.folder / "results/verdict.json").exists():
            killed += kill_when(run.start(), run.at_work(draw.randrange(6)))
        assert killed > before
        run()
        assert run.checksums() == finished.checksums()
        assert not list((run.folder / "results").rglob(".*.partial.*"))
    print(f"killed {killed} times in {runs} runs")


def test_a_run_on_a_full_disk_goes_on_after_space_is_freed(finished, tmp_path, small_disk):
    place = small_disk("size=100m")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/results").symlink_to(place)
    run = copied(finished, tmp_path / "run", place)
    used = sum(path.stat().st_blocks * 512 for path in place.rglob("*"))
    small_disk(f"size={used + 600_000}", remount=True)
    done = run(check=False)
    assert done.returncode != 0
    assert re.search(
        r"cannot be written: No space left on device; free some space", done.stdout + done.stderr
    )
    assert not list(place.rglob(".*.partial.*"))
    small_disk("size=100m", remount=True)
    run()
    assert run.checksums() == finished.checksums()


def test_a_run_in_a_read_only_folder_is_one_sentence(finished, tmp_path, small_disk):
    place = small_disk("size=100m")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/results").symlink_to(place)
    run = copied(finished, tmp_path / "run", place)
    small_disk("ro", remount=True)
    done = run(check=False)
    assert done.returncode != 0
    assert (
        "vibraverse: results cannot be written: Read-only file system; make it writable"
        in done.stdout + done.stderr
    )
    assert "Traceback" not in done.stdout + done.stderr
    small_disk("rw", remount=True)
    run()
    assert run.checksums() == finished.checksums()
