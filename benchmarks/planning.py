"""Cost of planning: `snakemake -n` over many generated objects, all at once and one slice of them.

python benchmarks/planning.py [OBJECTS] [SLICES] [--slice-only]

Two solidities, four materials, every other key at its default. Nothing is computed; the process is measured as a whole.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def plan(folder: Path, *arguments: str) -> tuple[int, float, float, float]:
    """Return jobs, wall seconds, CPU seconds and peak MB of a dry run."""
    command = [
        sys.executable, "-m", "snakemake", "-n", "--snakefile", str(ROOT / "Snakefile"), "--cores", "1",
        "--workflow-profile", str(ROOT / "workflow/profiles/default"), *arguments,
    ]  # fmt: skip
    with open(folder / "out.txt", "w+") as out:
        started = time.perf_counter()
        process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - started
        out.seek(0)
        text = out.read()
    totals = re.findall(r"^total +(\d+)$", text, re.MULTILINE)
    if status or not totals:
        sys.exit(text[-2000:])
    return int(totals[-1]), wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("objects", type=int, nargs="?", default=2000)
    parser.add_argument("slices", type=int, nargs="?", default=50)
    parser.add_argument("--slice-only", action="store_true", help="leave the whole plan out")
    chosen = parser.parse_args()
    shards = max(chosen.slices, chosen.objects // 500)
    whole = [] if chosen.slice_only else [("all", ())]
    print(
        f"{chosen.objects} objects\n{'plan':<8}{'jobs':>8}{'wall s':>9}{'CPU s':>9}{'most MB':>9}{'ms/job':>8}"
    )
    for name, arguments in [*whole, (f"1/{chosen.slices}", ("--config", f"slice=1/{chosen.slices}"))]:
        with tempfile.TemporaryDirectory(prefix="vibraverse-planning-") as folder:
            Path(folder, "config.yaml").write_text(
                f"sources: {{generated: {{count: {chosen.objects}}}, bundled: []}}\ndataset: {{shards: {shards}}}\n"
            )
            jobs, wall, cpu, memory = plan(Path(folder), *arguments)
        print(f"{name:<8}{jobs:>8}{wall:>9.1f}{cpu:>9.1f}{memory:>9.0f}{1000 * cpu / jobs:>8.2f}", flush=True)


if __name__ == "__main__":
    main()
