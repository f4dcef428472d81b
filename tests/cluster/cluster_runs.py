"""Commands and options that the tests on a cluster share."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

from workflow_runs import TINY

HERE = Path(__file__).resolve().parent

#: One hollow body: eight jobs in a row.
HOLLOW = {**TINY, "solidities": ["hollow"]}
#: From meshes to sounds: the families of geometry and finite elements, without pictures, dataset and report.
CHAIN = ("--until", "audio")
#: What a Slurm without accounting on one machine needs. The plugin looks at a job after 3 s and again 13 s later, when
#: nearly every job has ended; its next delays are 10 s longer each.
QUICK = (
    *CHAIN,
    "--latency-wait", "20", "--max-status-checks-per-second", "10",
    "--slurm-status-command", "squeue", "--slurm-init-seconds-before-status-checks", "3",
)  # fmt: skip


def call(*command: str, **options) -> subprocess.CompletedProcess:
    """Run a command that must succeed."""
    done = subprocess.run(command, capture_output=True, text=True, **options)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done


def slurm_script(*arguments: str) -> None:
    """Start, stop or disturb the test's Slurm."""
    call(str(HERE / "slurm.sh"), *arguments)


def wait_for(what, seconds: float = 120):
    """Return ``what()`` as soon as it is true."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        found = what()
        if found:
            return found
        time.sleep(0.2)
    raise AssertionError(f"waited {seconds} s in vain")


def running(rule: str) -> list[str]:
    """Return the ids of a rule's running jobs."""
    lines = call("squeue", "-h", "-t", "RUNNING", "-o", "%i|%k").stdout.splitlines()
    return [line.split("|")[0] for line in lines if rule in line.split("|")[1]]
