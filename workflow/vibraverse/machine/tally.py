"""The progress of a run from Snakemake's events: jobs done, running, refused and failed by rule, and the time left."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from vibraverse.contract.refusal import Refusal, read_refusal
from vibraverse.flow.steps import BY_NAME

#: Rules that only ask for others, and the sum in Snakemake's table.
_NO_STAGES = ("all", "total")


@dataclass
class Stage:
    """The jobs of one rule; ``seconds`` is the total time of those that ended."""

    total: int
    done: int = 0
    running: int = 0
    refused: int = 0
    seconds: float = 0.0

    @property
    def mean_seconds(self) -> float | None:
        """Mean time of a job; None before the first has ended."""
        return self.seconds / self.done if self.done else None


@dataclass(frozen=True)
class Job:
    """A job that began: its rule, its object or other wildcards, its outputs and logs."""

    rule: str
    about: str
    outputs: Sequence[str]
    logs: Sequence[str]
    began: float = 0.0

    def __str__(self) -> str:
        return f"{self.rule} of {self.about}" if self.about else self.rule

    def refusal(self) -> Refusal | None:
        """Return the refusal in place of its first product, or None."""
        if not self.outputs:
            return None
        place, step = Path(self.outputs[0]), BY_NAME.get(self.rule)
        return read_refusal(next(iter(step.outputs.values())).record_in(place) if step else place)


@dataclass
class Tally:
    """The state of a run. ``refusals`` counts new refusals by (stage, reason), not those passed on."""

    clock: Callable[[], float] = time.monotonic
    stages: dict[str, Stage] = field(default_factory=dict)
    failed: dict[str, Job] = field(default_factory=dict)
    refusals: Counter = field(default_factory=Counter)
    began: float | None = None
    #: The innermost folder that contains everything made so far.
    place: str = ""
    _jobs: dict[str, Job] = field(default_factory=dict)
    _running: dict[str, Job] = field(default_factory=dict)
    _busy: float = 0.0
    _seen: float = 0.0

    def plan(self, counts: Mapping[str, int]) -> None:
        """Set the number of jobs by rule, in the order of the chain."""
        self.stages = {rule: Stage(count) for rule, count in counts.items() if rule not in _NO_STAGES}

    def begin(self, number: str, job: Job) -> None:
        """Record that a job began, for the first time or for a retry."""
        if job.rule in _NO_STAGES:
            return
        if self.began is None:
            self.began = self._seen = self.clock()
        now = self._pass_time()
        self._drop(number)
        self.failed.pop(number, None)
        job = Job(job.rule, job.about, job.outputs, job.logs, now)
        self._jobs[number] = self._running[number] = job
        self.stages.setdefault(job.rule, Stage(0)).running += 1

    def end(self, number: str) -> None:
        """Record that a job made its products, or refusals in their place."""
        now, job = self._pass_time(), self._drop(number)
        if job is None:
            return
        del self._jobs[number]
        stage = self.stages[job.rule]
        stage.done += 1
        stage.total = max(stage.total, stage.done)
        stage.seconds += now - job.began
        refusal = job.refusal()
        if refusal is not None:
            stage.refused += 1
            if refusal.stage == job.rule:
                self.refusals[job.rule, refusal.reason] += 1
        if job.outputs:
            folder = os.path.dirname(job.outputs[0])
            self.place = os.path.commonpath([self.place, folder]) if self.place else folder

    def fail(self, number: str) -> Job | None:
        """Record that a job failed; return it, or None if it had not begun."""
        self._pass_time()
        self._drop(number)
        job = self._jobs.get(number)
        if job is not None:
            self.failed[number] = job
        return job

    def _drop(self, number: str) -> Job | None:
        """Remove a job from the running ones; return it."""
        job = self._running.pop(number, None)
        if job is not None:
            self.stages[job.rule].running -= 1
        return job

    def _pass_time(self) -> float:
        """Add the time since the last call to the busy time, once per running job; return the time."""
        now = self.clock()
        self._busy += len(self._running) * (now - self._seen)
        self._seen = now
        return now

    @property
    def whole(self) -> Stage:
        """All stages as one."""
        names = ("total", "done", "running", "refused", "seconds")
        return Stage(*(sum(getattr(stage, name) for stage in self.stages.values()) for name in names))

    def seconds(self) -> float:
        """Return the time in seconds since the first job began."""
        return 0.0 if self.began is None else self.clock() - self.began

    def seconds_left(self) -> tuple[float | None, bool]:
        """Return the estimated time left in seconds, and whether every stage's mean time is known.

        The work left is the sum over stages of the jobs left times their mean time. It is divided by the mean number of
        parallel jobs so far. Stages without an ended job count nothing. None if nothing is known.
        """
        now = self._pass_time()
        left = {rule: stage.total - stage.done for rule, stage in self.stages.items()}
        for job in self.failed.values():
            left[job.rule] -= 1
        means = {rule: stage.mean_seconds for rule, stage in self.stages.items()}
        known = all(means[rule] is not None for rule, count in left.items() if count > 0)
        if self.began is None or not self._busy or all(mean is None for mean in means.values()):
            return None, known
        work = sum(count * (means[rule] or 0.0) for rule, count in left.items())
        work -= sum(min(now - job.began, means[job.rule] or 0.0) for job in self._running.values())
        return max(0.0, work) * (now - self.began) / self._busy, known
