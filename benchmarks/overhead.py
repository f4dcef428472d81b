"""Overhead of a run besides computing: process starts, imports and Snakemake, for many small objects.

python benchmarks/overhead.py [OBJECTS] [--only plain|warm] [--repeat OBJECTS]

Runs the whole workflow on compact generated objects with one core, with every job as a new process (plain) and as a
fork of a warm process (warm, the default). Then it repeats the command of every job, taken from its log, in one process
in which everything is imported and compiled, and child processes are plain calls. The time of that is the useful
computing; the rest of a run's time is overhead.
With --repeat, only the jobs of that many random objects are repeated, and their mean is used for all.
Times are CPU seconds of all processes, so that other work on the machine affects them little. They do not include
waiting for the disk.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import io
import os
import random
import shlex
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

_PR_SET_CHILD_SUBREAPER = 36
ROOT = Path(__file__).resolve().parent.parent
CONFIG = """\
sources: {{generated: {{count: {count}, families: [bar, blob, ring, pawn]}}, bundled: []}}
tets: {{target_elements: 1500}}
basis: {{modes: 32}}
images: {{looks: [clay]}}
"""


def snakemake(folder: Path, variables: dict[str, str]) -> float:
    """Run the workflow; return the CPU seconds of all its processes, including those that outlive it."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = [
        sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", "1",
        "--workflow-profile", str(ROOT / "workflow/profiles/default"),
    ]  # fmt: skip
    before = cpu_s()
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "PATH": path, **variables}, capture_output=True, text=True
    )
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    if done.returncode != 0:
        sys.exit(done.stdout + done.stderr)
    return cpu_s() - before


def cpu_s() -> float:
    """Return the CPU seconds of this process and of the children it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def replay(folder: Path, objects: int | None) -> tuple[dict[str, list[float]], dict[str, int]]:
    """Repeat jobs in this process; return stage -> seconds of each job but the first, and stage -> number of jobs."""
    from vibraverse import cli
    from vibraverse.contract import limits

    def call(function, *arguments, **_):
        return function(*arguments)

    limits.run_limited = call
    os.chdir(folder)
    cli.set_threads(1)
    logs = sorted(Path("results/logs").rglob("*.log"), key=lambda path: path.stat().st_mtime)
    made = sorted(log.parent.name for log in logs if log.name == "sources.log")
    chosen = set(random.Random(0).sample(made, objects or len(made)))
    seen: set[str] = set()
    useful, jobs = defaultdict(list), Counter()
    for log in logs:
        command = shlex.split(log.read_text(encoding="utf-8").splitlines()[0])
        if command[0] != "vibraverse" or command[1] not in cli.STAGES:
            continue
        kind = log.name
        jobs[command[1]] += 1
        if log.parent.name in made and log.parent.name not in chosen:
            continue
        for _ in range(1 if kind in seen else 2):  # the first job of a kind imports and compiles
            with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
                before = cpu_s()
                if cli.main(command[1:]) != 0:
                    sys.exit(f"{shlex.join(command)} failed")
                seconds = cpu_s() - before
        seen.add(kind)
        useful[command[1]].append(seconds)
    return useful, jobs


def report(totals: dict[str, float], useful: dict[str, list[float]], jobs: dict[str, int]) -> None:
    """Print the useful computing of each stage, and the overhead of the runs."""
    print(f"{'stage':<10}{'jobs':>6}{'useful CPU s per job':>22}")
    for stage, seconds in useful.items():
        print(f"{stage:<10}{jobs[stage]:>6}{sum(seconds) / len(seconds):>22.2f}")
    count = sum(jobs.values())
    computing = sum(jobs[stage] * sum(seconds) / len(seconds) for stage, seconds in useful.items())
    print(f"{count} jobs, useful {computing:.1f} CPU s")
    for name, total in totals.items():
        besides = total - computing
        print(
            f"{name}: {total:.1f} CPU s, {besides / count:.2f} besides per job, {besides / total:.0%} of the total"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("objects", type=int, nargs="?", default=10)
    parser.add_argument("--only", choices=("plain", "warm"), help="leave the other run out")
    parser.add_argument(
        "--repeat", type=int, metavar="OBJECTS", help="repeat the jobs of so many (default: all)"
    )
    chosen = parser.parse_args()
    runs = {"plain": {"VIBRAVERSE_WARM": ""}, "warm": {}}
    totals = {}
    with tempfile.TemporaryDirectory(prefix="vibraverse-overhead-") as kept:
        for name in [chosen.only] if chosen.only else runs:
            folder = Path(kept, name)
            folder.mkdir()
            (folder / "config.yaml").write_text(CONFIG.format(count=chosen.objects))
            totals[name] = snakemake(folder, runs[name])
        useful, jobs = replay(folder, chosen.repeat)
        os.chdir("/")
    report(totals, useful, jobs)


if __name__ == "__main__":
    main()
