"""A full disk under strike, a stage and every command that writes: exit 1, one sentence, nothing half-written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import trimesh

import make_products
from test_readable import as_nobody
from vibraverse.contract import products
from vibraverse.contract.errors import NotStored
from vibraverse.contract.refusal import Refusal

NO_ROOM = "cannot be written: No space left on device; free some space, then repeat the command."


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The products of a ball, a bar and a leaf, and their dataset."""
    return make_products.build(tmp_path_factory.mktemp("full") / "results")


@pytest.fixture
def cube(tmp_path) -> Path:
    """A mesh that is quick to compute."""
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "cube.obj")
    return tmp_path / "cube.obj"


def command(*arguments, **environment) -> subprocess.CompletedProcess:
    """Run a command in a process of its own, because its end is part of the contract."""
    return subprocess.run(
        [sys.executable, "-m", "vibraverse", *map(str, arguments)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )


def strike(cube: Path, *more, **environment) -> subprocess.CompletedProcess:
    return command("strike", cube, "--elements", 300, "--modes", 8, "--order", 1, *more, **environment)


def assert_full(done: subprocess.CompletedProcess, sentence: str) -> None:
    """Assert that a command ended with this sentence, and no traceback of ours before it; HDF5 may say more."""
    assert done.returncode == 1, done.stderr
    assert done.stderr.splitlines()[-1] == f"vibraverse: {sentence}"
    assert "vibraverse/cli.py" not in done.stderr


def fill(disk: Path, left: int) -> None:
    """Fill a disk except for this many bytes."""
    free = os.statvfs(disk)
    (disk / "full").write_bytes(b"x" * (free.f_bavail * free.f_frsize - left))


@pytest.mark.parametrize("option", ["-o", "--json"])
def test_strike_onto_a_full_disk(cube, small_disk, tmp_path, option):
    disk, temporary = small_disk("size=1m"), tmp_path / "temporary"
    temporary.mkdir()
    fill(disk, 0)
    elsewhere = ["-o", tmp_path / "cube.wav"] if option == "--json" else []
    done = strike(cube, option, disk / "new", *elsewhere, TMPDIR=str(temporary))
    assert_full(done, f"{disk / 'new'} {NO_ROOM}")
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in disk.iterdir()] == ["full"]
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("left_kb", [8, 32, 96])
def test_strike_with_its_temporary_folder_on_a_full_disk(cube, small_disk, tmp_path, left_kb):
    """Each of several stages fills the disk: sources with 8 kB left, tets with 32, basis with 96."""
    disk = small_disk("size=4m")
    fill(disk, left_kb * 1024)
    done = strike(cube, "-o", tmp_path / "cube.wav", TMPDIR=str(disk))
    assert done.returncode == 1, done.stdout
    last = done.stderr.splitlines()[-1]
    assert last.startswith("vibraverse: ")
    assert f" {NO_ROOM.rstrip('.')} (strike works in {disk}: set TMPDIR to a folder with more room)" in last
    assert "Traceback" not in done.stderr
    assert [path.name for path in disk.iterdir()] == ["full"]
    assert not (tmp_path / "cube.wav").exists()


def test_a_stage_on_a_full_disk(made, small_disk):
    disk = small_disk("size=1m")
    fill(disk, 16 * 1024)
    surface = made.at(made.surface, object="bar-0000")
    grids, coarse = disk / "grids.h5", disk / "coarse.obj"
    done = command(
        "grids", "--object", "bar-0000", "--surface", surface, "--grids", grids, "--coarse", coarse
    )
    assert_full(done, f"grids: {grids} {NO_ROOM}")
    assert [path.name for path in disk.iterdir()] == ["full"]


@pytest.mark.parametrize("left", [0, 4096])
def test_a_refusal_is_passed_on_to_a_full_disk(small_disk, tmp_path, left):
    """There is room for the first file and not for the second, or for neither."""
    surface = tmp_path / "surface.ply"
    surface.write_text(Refusal("cup", "clean", "empty", "No triangles. " * 200).to_text())
    disk = small_disk("size=64k")
    fill(disk, left)
    grids, coarse = disk / "grids.h5", disk / "coarse.obj"
    arguments = ("grids", "--object", "cup", "--surface", surface, "--grids", grids, "--coarse", coarse)
    done = command(*arguments)
    full = coarse if left else grids
    assert_full(done, f"grids: {full} {NO_ROOM}")
    there = {path.name for path in disk.iterdir()}
    assert there == ({"full", "grids.h5"} if left else {"full"})
    assert (
        not left or grids.read_text() == surface.read_text()
    )  # whole, and the next attempt goes on from here
    (disk / "full").unlink()
    assert command(*arguments).returncode == 0
    assert grids.read_text() == coarse.read_text() == surface.read_text()


def test_a_refusal_is_passed_on_to_a_closed_folder(tmp_path):
    from vibraverse.contract.stage import Job, run
    from vibraverse.flow.steps import BY_NAME

    surface, closed = tmp_path / "surface.ply", tmp_path / "closed"
    surface.write_text(Refusal("cup", "clean", "empty", "No triangles.").to_text())
    closed.mkdir(mode=0o555)
    final = {"grids": closed / "grids.h5", "coarse": closed / "coarse.obj"}
    for folder in (tmp_path, *tmp_path.parents):
        if folder == tmp_path or folder.name.startswith(("pytest-", "popen-")):
            folder.chmod(0o755)  # pytest keeps its folders to its user
    job = Job(BY_NAME["grids"], "cup", "", {"surface": surface}, final, None)
    with (
        as_nobody(),
        pytest.raises(NotStored, match=r"^grids: .*grids\.h5 cannot be written: Permission denied"),
    ):
        run(job, None, [])
    assert list(closed.iterdir()) == []


COMMANDS = {
    "webdataset": ("export", "{dataset}", "--format", "webdataset", "-o", "{disk}/new"),
    "parquet": ("export", "{dataset}", "--format", "huggingface", "-o", "{disk}/new"),
    "join": ("join", "{dataset}", "-o", "{disk}/new"),
    "refusals": ("refusals", "--record", "{dataset}/dataset.json", "--verdict", "{disk}/new"),
    "validation": ("validation", "--record", "{validation}", "--verdict", "{disk}/new"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_writes_to_a_full_disk(made, small_disk, tmp_path, name):
    disk, validation = small_disk("size=1m"), tmp_path / "validation.json"
    validation.write_text('{"missed": [], "bodies": {}}')
    fill(disk, 0)
    places = {"dataset": made.dataset, "disk": disk, "validation": validation}
    done = command(*(word.format(**places) for word in COMMANDS[name]))
    assert done.returncode == 1, done.stderr
    assert done.stderr.splitlines()[-1].startswith(f"vibraverse: {disk / 'new'}")
    assert done.stderr.splitlines()[-1].endswith(NO_ROOM)
    assert "Traceback" not in done.stderr
    assert [path.name for path in disk.iterdir()] == ["full"]


@pytest.mark.parametrize("arguments", [("materials",), ("objects", "--families"), ("config", "schema")])
def test_a_command_whose_output_goes_to_a_full_disk(arguments):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "vibraverse", *arguments], stdout=full, stderr=subprocess.PIPE, text=True
        )
    assert (done.returncode, done.stderr) == (1, f"vibraverse: what the command writes {NO_ROOM}\n")


def test_a_sentence_names_the_product_and_not_what_is_written_aside(tmp_path):
    inside = products.aside(tmp_path / "sounds") / "audio.json"
    assert products.not_stored(OSError(28, "No space"), inside) == f"{tmp_path}/sounds/audio.json {NO_ROOM}"
    with pytest.raises(NotStored, match=r"^a\.h5 cannot be written: No space"), products.storing("a.h5"):
        raise ValueError("Unable to synchronously write (errno = 28, error message = …)")
    denied = PermissionError(13, "Permission denied", str(tmp_path / "input"))
    assert products.not_stored(denied, tmp_path / "output") == ""
    assert "Permission denied; make it writable" in products.not_stored(denied, tmp_path / "input")
