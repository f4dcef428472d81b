"""Cost of Snakemake itself while jobs run: CPU time, threads, and jobs per second.

python benchmarks/scheduling.py [OBJECTS] [--seconds 0.5] [--cores 8]

A shell script that sleeps and makes the requested files replaces every stage, so that only Snakemake with this workflow
is left. It compares, in the same run, Snakemake by itself with Snakemake as the workflow runs it: with the patch of
`vibraverse.machine.internals` and the default profile's `scheduler-subsample`.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
#: The script in place of `vibraverse`; it makes every path below results in its options. The end of a run reads counts.
STAGE = """\
#!/bin/sh
sleep {seconds}
while [ $# -gt 1 ]; do
  case "$1" in
    --sounds|--views) mkdir -p "$2";;
    --*) case "$2" in results/*) [ -e "$2" ] || {{
      mkdir -p "$(dirname "$2")"; echo '{{"counts": {{"objects": 1, "refused_objects": 0}}}}' > "$2"; }};; esac;;
  esac
  shift
done
"""
#: Snakemake in a process that prints its costs at the end; with `alone`, its scheduler is not patched.
MEASURED = """\
import os, resource, sys, threading, time
from vibraverse.machine import internals
if sys.argv.pop(1) == "alone":
    internals.patch_scheduler = lambda workflow: None
most, began = [0], time.monotonic()
def watch():
    while True:
        most[0] = max(most[0], threading.active_count())
        time.sleep(0.2)
threading.Thread(target=watch, daemon=True).start()
from snakemake.cli import main
try:
    main()
finally:
    used = resource.getrusage(resource.RUSAGE_SELF)
    print("measured", used.ru_utime + used.ru_stime, time.monotonic() - began, most[0])
"""


def run(folder: Path, how: str, cores: int) -> tuple[float, float, int]:
    """Return the CPU seconds of Snakemake's own process, wall seconds and the peak number of threads."""
    command = [
        sys.executable, "-c", MEASURED, how, "--snakefile", str(ROOT / "Snakefile"), "--cores", str(cores),
        "--workflow-profile", str(ROOT / "workflow/profiles/default"),
        *(["--scheduler-subsample", "1000000"] if how == "alone" else []),
    ]  # fmt: skip
    path = os.pathsep.join([str(folder / "bin"), str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True
    )
    line = next((line for line in done.stdout.splitlines() if line.startswith("measured ")), None)
    if done.returncode != 0 or line is None:
        sys.exit(done.stdout[-2000:] + done.stderr[-2000:])
    own, wall, threads = line.split()[1:]
    return float(own), float(wall), int(threads)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("objects", type=int, nargs="?", default=100)
    parser.add_argument("--seconds", type=float, default=0.5, help="that a job sleeps")
    parser.add_argument("--cores", type=int, default=8)
    chosen = parser.parse_args()
    print("| Snakemake | jobs | CPU s of its own | ms a job | wall s | most threads |\n|" + 6 * " --- |")
    for how in ("alone", "as the workflow runs it"):
        with tempfile.TemporaryDirectory(prefix="vibraverse-scheduling-") as kept:
            folder = Path(kept)
            (folder / "config.yaml").write_text(
                f"sources: {{generated: {{count: {chosen.objects}}}, bundled: []}}\n"
            )
            stage = folder / "bin/vibraverse"
            stage.parent.mkdir()
            stage.write_text(STAGE.format(seconds=chosen.seconds))
            stage.chmod(0o755)
            own, wall, threads = run(folder, how, chosen.cores)
            jobs = sum(1 for _ in (folder / "results/benchmarks").rglob("*.tsv"))
        print(
            f"| {how} | {jobs:,} | {own:.1f} | {1000 * own / jobs:.1f} | {wall:.0f} | {threads} |", flush=True
        )


if __name__ == "__main__":
    main()
