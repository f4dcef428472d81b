"""What a run costs besides computing: process starts, imports and Snakemake, for many small objects.

python benchmarks/overhead.py [OBJECTS] [--only plain|warm]

Runs the whole workflow on generated objects with one core, by itself and under `vibraverse warm`, then repeats the
command of every job, as its log states it, in one process in which everything is imported and compiled already and
child processes are plain calls. What that takes is called useful computing here; the rest of a run's time is overhead.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CONFIG = """\
sources: {{generated: {{count: {count}}}, bundled: []}}
tets: {{target_elements: 1500}}
basis: {{modes: 32}}
images: {{looks: [clay]}}
"""


def snakemake(folder: Path, prefix: tuple[str, ...]) -> float:
    """Run the workflow; return the wall seconds."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = [
        *prefix, sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", "1",
        "--workflow-profile", str(ROOT / "workflow/profiles/default"),
    ]  # fmt: skip
    started = time.perf_counter()
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True
    )
    if done.returncode != 0:
        sys.exit(done.stdout + done.stderr)
    return time.perf_counter() - started


def replay(folder: Path) -> dict[str, list[float]]:
    """Repeat every job in this process; return stage -> the seconds of each but the first object's."""
    from vibraverse import cli, limits

    def call(function, *arguments, seconds, memory_mb, what):
        return function(*arguments)

    limits.run_limited = call
    os.chdir(folder)
    cli.set_threads(1)
    logs = sorted(Path("results/logs").rglob("*.log"), key=lambda path: path.stat().st_mtime)
    seen: set[str] = set()
    useful = defaultdict(list)
    for log in logs:
        command = shlex.split(log.read_text(encoding="utf-8").splitlines()[0])
        if command[0] != "vibraverse" or command[1] not in cli.STAGES:
            continue
        kind = log.name
        for _ in range(1 if kind in seen else 2):  # the first of its kind imports and compiles
            with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
                started = time.perf_counter()
                if cli.main(command[1:]) != 0:
                    sys.exit(f"{shlex.join(command)} failed")
                seconds = time.perf_counter() - started
        seen.add(kind)
        useful[command[1]].append(seconds)
    return useful


def jobs(folder: Path) -> dict[str, list[float]]:
    """Return stage -> the wall seconds of its jobs, as Snakemake noted them."""
    found = defaultdict(list)
    for path in (folder / "results/benchmarks").rglob("*.tsv"):
        found[re.split(r"\.", path.name)[0]].append(float(path.read_text().splitlines()[1].split("\t")[0]))
    return found


def report(name: str, total: float, walls: dict[str, list[float]], useful: dict[str, list[float]]) -> None:
    """Print one run's costs by stage, and their sum."""
    print(f"\n{name}\n{'stage':<10}{'jobs':>6}{'s per job':>12}{'useful':>10}{'besides':>10}")
    for stage, seconds in useful.items():
        wall, needed = sum(walls[stage]) / len(seconds), sum(seconds) / len(seconds)
        print(f"{stage:<10}{len(seconds):>6}{wall:>12.2f}{needed:>10.2f}{wall - needed:>10.2f}")
    count, in_jobs = sum(map(len, useful.values())), sum(map(sum, walls.values()))
    computing = sum(map(sum, useful.values()))
    print(
        f"{count} jobs took {total:.1f} s: computing {computing:.1f} s, starts and imports "
        f"{in_jobs - computing:.1f} s, Snakemake {total - in_jobs:.1f} s\n"
        f"besides computing: {(total - computing) / count:.2f} s per job, {1 - computing / total:.0%} of the total",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("objects", type=int, nargs="?", default=10)
    parser.add_argument("--only", choices=("plain", "warm"), help="leave the other run out")
    chosen = parser.parse_args()
    runs = {"plain": (), "warm": (str(Path(sys.executable).with_name("vibraverse")), "warm")}
    measured = {}
    with tempfile.TemporaryDirectory(prefix="vibraverse-overhead-") as kept:
        for name in [chosen.only] if chosen.only else runs:
            folder = Path(kept, name)
            folder.mkdir()
            (folder / "config.yaml").write_text(CONFIG.format(count=chosen.objects))
            measured[name] = snakemake(folder, runs[name]), jobs(folder)
        useful = replay(folder)
        os.chdir("/")
    for name, (total, walls) in measured.items():
        report(name, total, walls, useful)


if __name__ == "__main__":
    main()
