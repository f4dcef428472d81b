"""Overhead of a run besides computing: process starts, imports, images, Slurm and Snakemake, for many small objects.

python benchmarks/overhead.py [OBJECTS] [--on KIND ...] [--until STAGE] [--normal] [--repeat OBJECTS]

Runs the whole workflow on generated objects, once for each kind:

plain          a workstation, every job a new process
warm           a workstation, jobs are forks of a warm process (the default of a run)
images         the same, every job in its family's image (make containers)
slurm          Slurm, a group of objects a job (profile slurm with its groups)
slurm-images   the same, in images
slices         Slurm, a slice of the objects a job (vibraverse submit)
slices-images  the same, in images

Then it repeats the command of every job, taken from its log, in one process in which everything is imported and
compiled, and child processes are plain calls. The time of that is the useful computing; the rest of a run's time is
overhead. With --repeat, only the jobs of that many random objects are repeated, and their mean is used for all.
Objects are compact, the hardest case; with --normal they are those of the default run.

Times are CPU seconds. On a workstation they are those of the run itself, so other work on the machine affects them
little. Slurm's daemons start jobs themselves, so there the whole machine counts: leave it idle. Waiting is not in them.
tests/cluster/slurm.sh start makes a Slurm of this machine.
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
import time
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
NORMAL = """\
sources: {{generated: {{count: {count}}}, bundled: []}}
"""

#: What a Slurm without accounts needs, and short waits.
SLURM = (
    "--slurm-status-command", "squeue", "--slurm-init-seconds-before-status-checks", "8", "--latency-wait", "20",
)  # fmt: skip


def run(kind: str, folder: Path, until: list[str]) -> float:
    """Run the workflow of a kind in a folder, up to a stage; return the CPU seconds that it takes."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)
    on_slurm, in_images = kind.startswith(("slurm", "slices")), kind.endswith("images")
    profile = "-".join(
        filter(None, ("slurm" if kind.startswith("slurm") else "", "apptainer" if in_images else ""))
    )
    profile = ROOT / "workflow/profiles" / (profile or "default")
    snakefile = ["--snakefile", str(ROOT / "Snakefile"), "--workflow-profile", str(profile)]
    if kind.startswith("slices"):
        submit = ["-m", "vibraverse", "submit", "--slices", "1", "--cores", "1", "--mem-mb", "12000"]
        command = [sys.executable, *submit, "--profile", str(profile), "--", *until]
    else:
        cores = SLURM if on_slurm else ("--cores", "1")
        command = [sys.executable, "-m", "snakemake", *snakefile, *cores, *until]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, **({"VIBRAVERSE_WARM": ""} if kind == "plain" else {})}
    measure = machine_cpu_s if on_slurm else cpu_s
    before = measure()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(done.stdout + done.stderr)
    if kind.startswith("slices"):
        wait_for_slurm()
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    return measure() - before


def wait_for_slurm() -> None:
    """Wait until the queue is empty."""
    while subprocess.run(["squeue", "-h", "--me"], capture_output=True, text=True, check=True).stdout.strip():
        time.sleep(2)


def machine_cpu_s() -> float:
    """Return the CPU seconds that all processes of this machine have taken."""
    with open("/proc/stat", encoding="ascii") as file:
        user, nice, system, _, _, irq, soft, *_ = map(int, file.readline().split()[1:])
    return (user + nice + system + irq + soft) / os.sysconf("SC_CLK_TCK")


def cpu_s() -> float:
    """Return the CPU seconds of this process and of the children it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def replay(folder: Path, objects: int | None) -> tuple[dict[str, list[float]], dict[str, int]]:
    """Repeat jobs in this process; return stage -> seconds of each job but the first, and stage -> number of jobs."""
    from vibraverse import cli
    from vibraverse.contract import limits
    from vibraverse.flow.steps import VERSIONS
    from vibraverse.machine.threads import set_threads

    def call(function, *arguments, **_):
        return function(*arguments)

    limits.run_limited = call
    os.chdir(folder)
    set_threads(1)
    logs = sorted(Path("results/logs").rglob("*.log"), key=lambda path: path.stat().st_mtime)
    made = sorted(log.parent.name for log in logs if log.name == "sources.log")
    chosen = set(random.Random(0).sample(made, objects or len(made)))
    seen: set[str] = set()
    useful, jobs = defaultdict(list), Counter()
    for log in logs:
        command = shlex.split(log.read_text(encoding="utf-8").splitlines()[0])
        if command[0] != "vibraverse" or command[1] not in VERSIONS:
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
    kinds = ("plain", "warm", "images", "slurm", "slurm-images", "slices", "slices-images")
    parser.add_argument("--on", nargs="+", choices=kinds, default=("plain", "warm"), help="kinds of run")
    parser.add_argument("--until", metavar="STAGE", help="the chain up to a stage: audio takes two images")
    parser.add_argument("--normal", action="store_true", help="objects of the default run, not compact ones")
    parser.add_argument(
        "--repeat", type=int, metavar="OBJECTS", help="repeat the jobs of so many (default: all)"
    )
    chosen = parser.parse_args()
    totals = {}
    # Below the working folder, which nodes and images see.
    with tempfile.TemporaryDirectory(prefix="vibraverse-overhead-", dir=".") as kept:
        for kind in chosen.on:
            folder = Path(kept, kind).absolute()
            folder.mkdir()
            config = NORMAL if chosen.normal else CONFIG
            (folder / "config.yaml").write_text(config.format(count=chosen.objects))
            totals[kind] = run(kind, folder, ["--until", chosen.until] if chosen.until else [])
            print(f"{kind}: {totals[kind]:.1f} CPU s in all", flush=True)
        back = os.getcwd()
        useful, jobs = replay(folder, chosen.repeat)
        os.chdir(back)
    report(totals, useful, jobs)


if __name__ == "__main__":
    main()
