"""Fixtures for all tests."""

from __future__ import annotations

import fcntl
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from vibraverse.machine.threads import set_threads

# As every job of a run, and before any test module loads a numerical library: threads that wait for each other on
# a busy machine cost many times what they save.
set_threads(1)

ROOT = Path(__file__).resolve().parent.parent
SHARED_MESHES = ROOT.parent / "shared" / "meshes"
SHARED_CASES = ROOT.parent / "shared" / "cases"


@pytest.fixture(scope="session")
def root() -> Path:
    """Project folder."""
    return ROOT


@pytest.fixture(scope="session")
def shared_meshes() -> Path:
    """Public test meshes that lie beside a developer's checkout; tests that need them skip without."""
    if not SHARED_MESHES.is_dir():
        pytest.skip("the public test meshes (../shared/meshes) are not here")
    return SHARED_MESHES


@pytest.fixture(scope="session")
def shared_cases() -> Path:
    """Files from public bug reports that lie beside a developer's checkout; tests that need them skip without."""
    if not SHARED_CASES.is_dir():
        pytest.skip("the cases from bug reports (../shared/cases) are not here")
    return SHARED_CASES


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put files that run the workflow in front: they take longest, and no process should end with one."""
    items.sort(key=lambda item: not hasattr(item.module, "Run"))


@pytest.fixture(scope="session")
def finished(tmp_path_factory, root, worker_id):
    """An undisturbed run of the tiny configuration. Tests may read and plan in it, but execute only in copies.

    The first process that asks makes it. Each plans in a copy of its own, as planning writes the configuration.
    """
    from workflow_runs import Run

    if worker_id == "master":  # no others
        run = Run(tmp_path_factory.mktemp("finished"), root)
        run()
        return run
    common = tmp_path_factory.getbasetemp().parent
    with (common / "finished.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (common / "finished").exists():
            folder = Path(tempfile.mkdtemp(dir=common))
            Run(folder, root)()
            folder.rename(common / "finished")
    return Run(shutil.copytree(common / "finished", tmp_path_factory.mktemp("own") / "finished"), root)


@pytest.fixture(scope="session")
def report_page(tmp_path_factory) -> Path:
    """The page of a small dataset of synthetic products. Tests must not change its folder."""
    import make_products

    results = tmp_path_factory.mktemp("report") / "results"
    make_products.build(results)
    return make_products.report(results, title="Things that ring")


@pytest.fixture
def small_disk(tmp_path):
    """A tmpfs whose size a test sets; only root may mount one."""
    place = tmp_path / "disk"
    place.mkdir()

    def mount(options: str, remount: bool = False) -> Path:
        options = f"remount,{options}" if remount else options
        done = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "tmpfs", place], capture_output=True, text=True
        )
        if done.returncode != 0:
            pytest.skip(f"a tmpfs cannot be mounted here ({done.stderr.strip()}): it takes root's rights")
        return place

    yield mount
    subprocess.run(["umount", place], capture_output=True)


@pytest.fixture
def vibraverse(capfd, monkeypatch):
    """Run the command line in this process: ``vibraverse("clean", …)`` returns (exit status, output, errors)."""
    from vibraverse.cli import main
    from vibraverse.contract import limits

    # A process of one job may keep all memory; in this one, and in what is forked from it, limits would then not hold.
    monkeypatch.setattr(limits, "keep_memory", lambda: None)

    def call(*arguments):
        try:
            status = main([str(argument) for argument in arguments])
        except SystemExit as exit_:
            status = exit_.code
        out, err = capfd.readouterr()
        return status, out, err

    return call


@pytest.fixture
def bin_(tmp_path, monkeypatch):
    """The only folder of the PATH besides the system's own tools."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")
    return folder
