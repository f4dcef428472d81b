"""A Slurm and the images of two families, installed and started for the tests of this folder.

They install Debian packages and start daemons, so they run on request alone: ``make test-cluster``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from cluster_runs import CHAIN, HERE, HOLLOW, call, slurm_script

from workflow_runs import Run


@pytest.fixture(scope="session")
def slurm():
    """A running Slurm: partitions ``cpu`` with two nodes and ``gpu`` with a stand-in."""
    if os.getuid() != 0:
        pytest.skip("only root can start a Slurm")
    slurm_script("start")
    yield
    slurm_script("stop")


@pytest.fixture(scope="session")
def images(root) -> Path:
    """The folder with the images of geometry and finite elements, as this checkout makes them."""
    from vibraverse.machine import containers

    call(str(HERE / "apptainer.sh"))
    call(sys.executable, str(root / "containers/build.py"), "--base", "debian", "geometry", "fem")
    return Path(containers.folder())


@pytest.fixture(scope="session")
def expected(root, tmp_path_factory) -> dict[str, str]:
    """The checksums of the same run on a workstation, without containers."""
    run = Run(tmp_path_factory.mktemp("workstation"), root, HOLLOW)
    run(*CHAIN)
    return run.checksums()


@pytest.fixture
def cluster_run(slurm, images, root, tmp_path) -> Run:
    """A run through Slurm with every job in its image."""
    return Run(tmp_path, root, HOLLOW, profile="slurm-apptainer")
