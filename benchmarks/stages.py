"""Costs of a run by stage, from the journal: wall and CPU seconds, and memory.

python benchmarks/stages.py [results]
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict

from vibraverse.contract.journal import Ended
from vibraverse.flow.paths import Paths
from vibraverse.upkeep import measured


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", nargs="?", default="results")
    results = parser.parse_args().results
    stages = defaultdict(list)
    for job in measured.read(Paths(results)).values():
        stages[job.stage].append(job)
    if not stages:
        sys.exit(f"{results}/journal notes no job that ended; run the workflow first.")
    everything = sum(job.cpu_s for jobs in stages.values() for job in jobs)
    print(
        f"{'stage':<10}{'jobs':>6}{'wall s':>10}{'per job':>10}{'CPU s':>10}{'per job':>10}{'share':>8}{'most MB':>10}"
    )
    for stage, jobs in sorted(stages.items(), key=lambda item: -sum(job.cpu_s for job in item[1])):
        line(stage, jobs, everything)
    line("all", [job for jobs in stages.values() for job in jobs], everything)


def line(name: str, jobs: list[Ended], everything: float) -> None:
    """Print the costs of these jobs."""
    wall, cpu = sum(job.wall_s for job in jobs), sum(job.cpu_s for job in jobs)
    most = max(job.memory_mb for job in jobs)
    print(
        f"{name:<10}{len(jobs):>6}{wall:>10.1f}{wall / len(jobs):>10.1f}{cpu:>10.1f}"
        f"{cpu / len(jobs):>10.1f}{cpu / (everything or 1):>8.0%}{most:>10.0f}"
    )


if __name__ == "__main__":
    main()
