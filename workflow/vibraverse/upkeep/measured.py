"""What jobs took, as the journal notes it, and what to ask for next time.

Memory is the largest seen and half as much again, time three times the largest seen: a job that asks for too
little runs twice, one that asks for a little too much only waits a little longer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from statistics import linear_regression, median

from vibraverse.contract import journal
from vibraverse.contract.journal import Ended
from vibraverse.flow.paths import Paths

#: Suggested over largest measured memory and time.
MEMORY_MARGIN, TIME_MARGIN = 1.5, 3.0
#: Suggestions are multiples of this, and never less: a process has it before it computes.
MEMORY_STEP_MB = 500
#: MB that Snakemake itself takes in every job of a cluster.
JOB_MB = 150

#: A stage, the object, shard or known body that its job is for, and the solidity.
Job = tuple[str, str, str]


@dataclass(frozen=True)
class Suggestion:
    """What the jobs of a rule took, and what to ask for; ``group`` is how many fill the wanted time."""

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
    """Return what the jobs of a results folder took, each when it last ended without a failure."""
    found: dict[Job, Ended] = {}
    for name in sorted(journal.names(paths.results)):
        found.update(journal.ended(paths.results, name))
    return found


def suggest(jobs: dict[Job, Ended], group_minutes: float) -> dict[str, Suggestion]:
    """Return a suggestion for each rule; ``group_minutes`` is how long a group of its jobs should take."""
    by_rule: dict[str, list[Ended]] = {}
    for one in jobs.values():
        by_rule.setdefault(one.stage, []).append(one)
    suggestions = {}
    for rule, ended in by_rule.items():
        seconds, memory = [one.wall_s for one in ended], [one.memory_mb for one in ended]
        wanted = MEMORY_MARGIN * max(memory) + JOB_MB
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
    """Return the unknowns of the sparse problem of each job that solved one, where its product is still there."""
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
    """Return MB at no unknowns and MB per 1,000 unknowns, by least squares; None where sizes differ too little."""
    if len(pairs) < 3 or max(pairs)[0] < 1.5 * min(pairs)[0]:
        return None
    slope, intercept = linear_regression(*zip(*pairs, strict=True))
    return intercept, 1000 * slope
