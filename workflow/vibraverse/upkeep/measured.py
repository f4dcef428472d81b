"""What jobs took, as Snakemake and their own logs note it, and what to ask for next time.

Snakemake samples a job's CPU time and memory, misses short peaks, and sees nothing of a job that a warm process forks;
the job's log ends with what it had itself. The larger of the two counts.

Memory is the largest seen and half as much again, time three times the largest seen: a job that asks for too
little runs twice, one that asks for a little too much only waits a little longer.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path
from statistics import linear_regression, median

from vibraverse.flow.paths import Paths

#: Suggested over largest measured memory and time.
MEMORY_MARGIN, TIME_MARGIN = 1.5, 3.0
#: Suggestions are multiples of this, and never less: Snakemake samples memory, and misses short peaks.
MEMORY_STEP_MB = 500
#: MB that Snakemake itself takes in every job of a cluster.
JOB_MB = 150

_LOGGED = re.compile(r": done in [\d.]+ s(?:, ([\d.]+) s of CPU)?, at most (\d+) MB$", re.MULTILINE)

#: A rule, and the folder and file that its job is measured in.
Job = tuple[str, str]


@dataclass(frozen=True)
class Measurement:
    """Wall and CPU seconds and largest resident memory of one job; None where nobody noted them."""

    seconds: float
    cpu_s: float | None
    memory_mb: float | None


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


def read(paths: Paths) -> dict[Job, Measurement]:
    """Return the measurements of all jobs of a results folder; files that are no measurements are passed over."""
    folder = Path(paths.results) / "benchmarks"
    found = {}
    for path in sorted(folder.rglob("*.tsv")):
        with open(path, encoding="utf-8", newline="") as file:
            row = next(csv.DictReader(file, delimiter="\t"), {})
        name = path.relative_to(folder)
        seconds = _number(row.get("s"))
        cpu, memory = _logged(folder.with_name("logs") / name.with_suffix(".log"))
        if seconds is not None:
            found[path.name.split(".")[0], str(name)] = Measurement(
                seconds,
                _larger(_number(row.get("cpu_time")), cpu),
                _larger(_number(row.get("max_rss")), memory),
            )
    return found


def _logged(log: Path) -> tuple[float | None, float | None]:
    """Return the CPU seconds and the most MB of a job by its log."""
    try:
        noted = _LOGGED.findall(log.read_text(encoding="utf-8", errors="replace"))
    except FileNotFoundError:
        noted = []
    return (_number(noted[-1][0]), float(noted[-1][1])) if noted else (None, None)


def _larger(*seen: float | None) -> float | None:
    return max((one for one in seen if one is not None), default=None)


def suggest(jobs: dict[Job, Measurement], group_minutes: float) -> dict[str, Suggestion]:
    """Return a suggestion for each rule; ``group_minutes`` is how long a group of its jobs should take."""
    by_rule: dict[str, list[Measurement]] = {}
    for (rule, _), one in jobs.items():
        by_rule.setdefault(rule, []).append(one)
    suggestions = {}
    for rule, measurements in by_rule.items():
        seconds = [one.seconds for one in measurements]
        memory = [one.memory_mb for one in measurements if one.memory_mb is not None] or [0.0]
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
                    measured = paths.at(
                        paths.benchmark("basis", "object", "solidity"), object=object_, solidity=body
                    )
                    name = str(Path(measured).relative_to(Path(paths.results) / "benchmarks"))
                    found["basis", name] = int(h5.attrs["n_unknowns"])
    return found


def growth(pairs: list[tuple[int, float | None]]) -> tuple[float, float] | None:
    """Return MB at no unknowns and MB per 1,000 unknowns, by least squares; None where sizes differ too little."""
    known = [(size, memory) for size, memory in pairs if memory is not None]
    if len(known) < 3 or max(known)[0] < 1.5 * min(known)[0]:
        return None
    slope, intercept = linear_regression(*zip(*known, strict=True))
    return intercept, 1000 * slope


def _number(text: str | None) -> float | None:
    """Return a number as Snakemake writes it; ``-`` and ``NA`` stand for none."""
    try:
        return float(text or "")
    except ValueError:
        return None
