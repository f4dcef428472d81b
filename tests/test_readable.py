"""Why a file cannot be read, in words, and the commands that say so."""

from __future__ import annotations

import os
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from vibraverse.contract.readable import unreadable

NOBODY = 65534


@contextmanager
def as_nobody():
    """Drop root's rights for a test, if this process has them."""
    if os.geteuid() == 0:
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if os.getuid() == 0:
            os.seteuid(0)


@pytest.fixture
def closed():
    """A file that the user may not read, in a folder that everybody may read."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        path = Path(folder, "closed.json")
        path.write_text("{}")
        path.chmod(0)
        yield path


def test_each_way_of_not_being_readable_has_its_words(tmp_path, closed):
    file, pipe, circle = (tmp_path / name for name in ("file", "pipe", "circle"))
    file.touch()
    os.mkfifo(pipe)
    circle.symlink_to(circle)
    assert unreadable(file) == ""
    assert unreadable(tmp_path / "none") == unreadable(file / "below") == "does not exist"
    assert unreadable(tmp_path / "none", missing="make it") == "does not exist; make it"
    assert unreadable(tmp_path) == "is a folder; name a file in it"
    assert unreadable(tmp_path, folder="name a.json in it") == "is a folder; name a.json in it"
    assert unreadable(pipe) == "is not a file"
    assert unreadable(circle).startswith("cannot be read: Too many levels of symbolic links")
    with as_nobody():
        assert unreadable(closed).startswith("cannot be read: Permission denied; ask its owner")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("provenance", "none"), "none does not exist; name a product, as in results/objects/ID/surface.ply"),
        (
            ("provenance", "results"),
            "results is a folder; name a product in it, such as results/verdict.json",
        ),
        (
            ("provenance", "results/objects"),
            "results/objects is a folder; name a product in it, such as results/objects/cup/clean.json",
        ),
        (("provenance", "empty"), "empty is a folder; name a product"),
        (("config", "check", "results"), "the configuration file results is a folder; name a file in it"),
        (
            ("status", "--config", "none"),
            "the configuration file none does not exist; create it, or name another one",
        ),
        (("strike", "results"), "the mesh file results is a folder; name a file in it"),
        (("strike", "none.obj"), "the mesh file none.obj does not exist; name an existing file"),
        (("refusals", "--record", "results"), "results is a folder; name dataset.json in it"),
        (("refusals", "--record", "none"), "none does not exist; finish the run, which makes the dataset"),
        (("validation", "--record", "results"), "results is a folder; name validation.json in it"),
        (("validation", "--record", "none"), "none does not exist; `snakemake validation` makes it"),
        (("check", "none"), "none does not exist; name a dataset's folder, or a shard"),
        (("check", "empty"), "empty holds no finished dataset: empty/dataset.json does not exist"),
        (("join", "none", "-o", "all.h5"), "none does not exist; name a dataset's folder, or a shard"),
        (
            ("export", "empty", "--format", "webdataset", "-o", "new"),
            "export: empty holds no finished dataset: empty/dataset.json does not exist",
        ),
        (
            ("grids", "--object", "a", "--surface", "results", "--grids", "a.h5", "--coarse", "a.obj"),
            "grids: the input results is a folder; name a file in it",
        ),
        (
            ("grids", "--object", "a", "--surface", "none", "--grids", "a.h5", "--coarse", "a.obj"),
            "grids: the input none does not exist; name an existing file",
        ),
    ],
)
def test_a_command_tells_a_missing_file_from_a_folder(tmp_path, monkeypatch, vibraverse, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    Path("results/objects/cup").mkdir(parents=True)
    Path("results/objects/cup/clean.json").touch()
    Path("results/verdict.json").touch()
    Path("empty").mkdir()
    before = sorted(tmp_path.rglob("*"))
    status, _, errors = vibraverse(*arguments)
    assert status == 2
    assert errors.splitlines()[-1] == f"vibraverse: {sentence}"
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    "command", ["config check", "provenance", "refusals --record", "validation --record"]
)
def test_a_command_tells_a_file_that_it_may_not_read(closed, vibraverse, command):
    with as_nobody():
        status, _, errors = vibraverse(*command.split(), closed)
    assert status == 2
    assert errors.endswith(
        f"{closed} cannot be read: Permission denied; ask its owner for the right to read it\n"
    )
