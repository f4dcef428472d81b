"""``vibraverse resources``: suggest memory, time and group sizes for each rule, from the journal of its jobs."""

from __future__ import annotations

import argparse

from vibraverse.commands import run_arguments, run_paths
from vibraverse.contract.errors import UsageError
from vibraverse.upkeep import measured


def main(argv: list[str]) -> int:
    """Print the suggestions, the growth of memory with the unknowns, and the lines for a profile."""
    parser = argparse.ArgumentParser(
        prog="vibraverse resources",
        parents=[run_arguments()],
        description="Suggest memory, time and group sizes for each rule from the jobs of a finished run.",
    )
    parser.add_argument(
        "--group-minutes",
        type=float,
        default=30,
        metavar="M",
        help="how long a group of jobs should run on a cluster (default %(default)s)",
    )
    chosen = parser.parse_args(argv)
    if chosen.group_minutes <= 0:
        raise UsageError(f"--group-minutes must be more than 0, not {chosen.group_minutes:g}")
    paths = run_paths(chosen)
    jobs = measured.read(paths)
    if not jobs:
        raise UsageError(f"{paths.journal} holds no job that ended; run the workflow first")
    suggestions = measured.suggest(jobs, chosen.group_minutes)
    print(table(suggestions))
    sizes = measured.unknowns(paths)
    for rule in sorted({job[0] for job in sizes}):
        pairs = [(sizes[job], jobs[job].memory_mb) for job in sizes if job in jobs and job[0] == rule]
        line = measured.growth(pairs)
        if line is not None:
            print(
                f"\n{rule}: about {line[0]:.0f} MB + {line[1]:.1f} MB per 1,000 unknowns ({len(pairs)} jobs)"
            )
    print(f"\n# For a profile's config.yaml:\n{snippet(suggestions)}", end="")
    return 0


def table(suggestions: dict[str, measured.Suggestion]) -> str:
    """Return the suggestions as text, the costliest rule first."""
    lines = [
        f"{'rule':<12}{'jobs':>7}{'s, median':>11}{'most':>9}{'MB, median':>12}{'most':>8}"
        f"{'mem_mb':>9}{'runtime':>9}{'group':>7}"
    ]
    for rule, one in sorted(suggestions.items(), key=lambda item: -item[1].total_s):
        lines.append(
            f"{rule:<12}{one.jobs:>7}{one.median_s:>11.1f}{one.most_s:>9.1f}{one.median_mb:>12.0f}{one.most_mb:>8.0f}"
            f"{one.mem_mb:>9}{one.runtime_min:>9}{one.group:>7}"
        )
    return "\n".join(lines)


def snippet(suggestions: dict[str, measured.Suggestion]) -> str:
    """Return the suggestions as ``set-resources`` of a profile; each retry gets twice the memory and more time."""
    lines = ["set-resources:"]
    for rule, one in sorted(suggestions.items()):
        lines.append(
            f'  {rule}: {{mem_mb: "{one.mem_mb} * 2 ** (attempt - 1)", runtime: "{one.runtime_min} * attempt"}}'
        )
    return "\n".join(lines) + "\n"
