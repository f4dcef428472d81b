"""Where a run's time went: wall and CPU seconds and memory by stage, from what Snakemake and the jobs' logs noted.

python benchmarks/stages.py [results]
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict

from vibraverse.flow.paths import Paths
from vibraverse.upkeep import measured


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("results", nargs="?", default="results")
    results = parser.parse_args().results
    stages = defaultdict(list)
    for (stage, _), job in measured.read(Paths(results)).items():
        stages[stage].append(job)
    if not stages:
        sys.exit(f"{results}/benchmarks holds no benchmark files; run the workflow first.")
    everything = sum(job.cpu_s or 0 for jobs in stages.values() for job in jobs)
    print(
        f"{'stage':<10}{'jobs':>6}{'wall s':>10}{'per job':>10}{'CPU s':>10}{'per job':>10}{'share':>8}{'most MB':>10}"
    )
    for stage, jobs in sorted(stages.items(), key=lambda item: -sum(job.cpu_s or 0 for job in item[1])):
        line(stage, jobs, everything)
    line("all", [job for jobs in stages.values() for job in jobs], everything)


def line(name: str, jobs: list[measured.Measurement], everything: float) -> None:
    """Print what these jobs took; CPU seconds per job are the mean of those that noted them."""
    wall, cpu = sum(job.seconds for job in jobs), [job.cpu_s for job in jobs if job.cpu_s is not None]
    most = max(job.memory_mb or 0 for job in jobs)
    print(
        f"{name:<10}{len(jobs):>6}{wall:>10.1f}{wall / len(jobs):>10.1f}{sum(cpu):>10.1f}"
        f"{sum(cpu) / max(len(cpu), 1):>10.1f}{sum(cpu) / (everything or 1):>8.0%}{most:>10.0f}"
    )


if __name__ == "__main__":
    main()
