"""Costs of jobs from the journal, and suggestions for the next run.

Suggested memory is 1.5 times the largest measured, suggested time 3 times the largest measured. A job that asks for too
little runs twice; one that asks for a little too much only waits a little longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from statistics import linear_regression, median

from vibraverse.contract import journal
from vibraverse.contract.journal import Ended
from vibraverse.flow.paths import Paths

#: Ratios of suggested to largest measured memory and time.
MEMORY_MARGIN, TIME_MARGIN = 1.5, 3.0
#: Step and minimum of suggested memory; a process takes this much before it computes.
MEMORY_STEP_MB = 500
#: Memory in MB that Snakemake itself takes in every cluster job.
SNAKEMAKE_JOB_MB = 150

#: A stage, the object, shard or known body that its job is for, and the solidity.
Job = tuple[str, str, str]


@dataclass(frozen=True)
class Suggestion:
    """Costs of a rule's jobs, and what to ask for; ``group`` is the number of jobs that fill the requested time."""

    jobs: int
    total_s: float
    median_s: float
    most_s: float
    median_mb: float
    most_mb: float
    mem_mb: int
    runtime_min: int
    group: int


def read(paths: Paths) -> dict[Job, Ended]:
    """Return the costs of the jobs of a results folder, each from its last end without a failure."""
    found: dict[Job, Ended] = {}
    for name in sorted(journal.names(paths.results)):
        found.update(journal.ended(paths.results, name))
    return found


def suggest(jobs: dict[Job, Ended], group_minutes: float) -> dict[str, Suggestion]:
    """Return a suggestion for each rule; ``group_minutes`` is the time that a group of its jobs should take."""
    by_rule: dict[str, list[Ended]] = {}
    for one in jobs.values():
        by_rule.setdefault(one.stage, []).append(one)
    suggestions = {}
    for rule, ended in by_rule.items():
        seconds, memory = [one.wall_s for one in ended], [one.memory_mb for one in ended]
        wanted = MEMORY_MARGIN * max(memory) + SNAKEMAKE_JOB_MB
        suggestions[rule] = Suggestion(
            jobs=len(seconds),
            total_s=sum(seconds),
            median_s=median(seconds),
            most_s=max(seconds),
            median_mb=median(memory),
            most_mb=max(memory),
            mem_mb=MEMORY_STEP_MB * math.ceil(wanted / MEMORY_STEP_MB),
            runtime_min=math.ceil(TIME_MARGIN * max(seconds) / 60) + 1,
            group=max(1, int(group_minutes * 60 / (sum(seconds) / len(seconds)))) if sum(seconds) else 1,
        )
    return suggestions


def unknowns(paths: Paths) -> dict[Job, int]:
    """Return the number of unknowns of each job that solved a sparse problem and whose product still exists."""
    import h5py

    found = {}
    pattern = Path(paths.basis)
    for path in sorted(Path(paths.results).glob("objects/*/*/" + pattern.name)):
        body, object_ = path.parent.name, path.parent.parent.name
        if h5py.is_hdf5(path):
            with h5py.File(path) as h5:
                if "n_unknowns" in h5.attrs:
                    found["basis", object_, body] = int(h5.attrs["n_unknowns"])
    return found


def growth(pairs: list[tuple[int, float]]) -> tuple[float, float] | None:
    """Return MB at zero unknowns and MB per 1,000 unknowns, by least squares; None if the sizes differ too little."""
    if len(pairs) < 3 or max(pairs)[0] < 1.5 * min(pairs)[0]:
        return None
    slope, intercept = linear_regression(*zip(*pairs, strict=True))
    return intercept, 1000 * slope
