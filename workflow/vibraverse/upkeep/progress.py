"""The progress of a run: which products of the configured objects exist, which jobs work now, and what is left.

Reads names, not files, except the journal and the first bytes of products, which tell refusals.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from vibraverse.contract import journal
from vibraverse.contract.journal import Worker
from vibraverse.contract.refusal import is_refusal
from vibraverse.flow import targets
from vibraverse.flow.chain import refusals_of
from vibraverse.flow.paths import Paths
from vibraverse.flow.plan import Plan
from vibraverse.flow.steps import BY_NAME, CHAIN
from vibraverse.upkeep.lineage import jobs

#: Objects whose journals are read for the mean times of stages, about.
_SAMPLE_SIZE = 40
#: Placeholder for the object in paths that hold for all objects.
_ANY_OBJECT = "_"
_CHAIN_STAGES = {step.name for step in CHAIN}


@dataclass(frozen=True, eq=False)
class Kind:
    """A job that every object has: its files, its record among them, and the jobs before it.

    Paths are below the object's folder.
    """

    stage: str
    solidity: str
    files: list[tuple[str, str]]
    record: str
    before: list[Kind]


@dataclass(frozen=True)
class Work:
    """A job that works now: its process, its file in the journal, its log, and whether it is orphaned."""

    worker: Worker
    file: Path
    log: str
    orphaned: bool = False


@dataclass
class Survey:
    """The state of the configured objects.

    ``objects`` counts objects by state: ``done``, ``refused`` (nothing is left), ``begun`` and ``missing``.
    ``body_by_body`` counts refused objects whose bodies were refused one by one; ``in_part`` counts objects with one
    refused body. ``jobs`` counts jobs by stage and state: ``done``, ``refused``, ``running``, ``stopped`` (begun, but
    no process works on it) and ``waiting``. ``works`` are the running jobs, those of shards and the dataset included.
    ``runs`` counts the runs that work. ``refusals`` are rows of ``refusals.tsv``. ``stopped`` lists the logs of stopped
    jobs. ``strangers`` counts objects that the configuration does not name.
    """

    objects: Counter = field(default_factory=Counter)
    in_part: int = 0
    body_by_body: int = 0
    runs: int = 0
    works: list[Work] = field(default_factory=list)
    jobs: dict[str, Counter] = field(default_factory=lambda: {step.name: Counter() for step in CHAIN})
    refusals: list[dict] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)
    strangers: int = 0

    def left(self) -> dict[str, int]:
        """Return the number of jobs left by stage."""
        return {
            stage: counts["running"] + counts["stopped"] + counts["waiting"]
            for stage, counts in self.jobs.items()
        }

    @property
    def running(self) -> int:
        """Number of jobs of objects that the runs work on now."""
        return sum(work.worker.stage in self.jobs and not work.orphaned for work in self.works)


def survey(plan: Plan) -> Survey:
    """Return the state of all configured objects."""
    begun = list(
        journal.begun(plan.paths.results)
    )  # before the runs: a run's file exists before those of its jobs
    runs = journal.working_runs(plan.paths.results)
    works, stopped = _working_and_stopped(begun, plan.paths, set(runs))
    others = [work for job, work in works.items() if work.orphaned or job[0] not in _CHAIN_STAGES]
    found = Survey(runs=len(runs), works=others)
    kinds = kinds_of(plan)
    places = {place for kind in kinds for place, _ in kind.files}
    root = os.path.dirname(plan.paths.at(plan.paths.object, object=_ANY_OBJECT))
    there = set(_names(root))
    found.strangers = len(there - set(plan.objects))
    for object_id in plan.objects:
        folder = f"{root}/{object_id}"
        names = {place: _names(f"{folder}/{place}") if object_id in there else set() for place in places}
        done = {kind for kind in kinds if all(name in names[place] for place, name in kind.files)}
        refused: set[Kind] = set()
        followed = {before for kind in done for before in kind.before}
        if any(is_refusal(f"{folder}/{kind.record}") for kind in done - followed):
            refused = {kind for kind in done if is_refusal(f"{folder}/{kind.record}")}
        gone = False
        if refused:
            refusals = refusals_of(plan.paths, object_id, plan.config.solidities)
            found.refusals += refusals.rows(object_id)
            gone = refusals.is_refused(plan.config.solidities)
            found.in_part += not gone
            found.body_by_body += gone and refusals.object is None
        if gone:
            found.objects["refused"] += 1
        else:
            found.objects["done" if len(done) == len(kinds) else "begun" if done else "missing"] += 1
        for kind in kinds:
            state = "refused" if kind in refused else "done" if kind in done else "waiting"
            job = kind.stage, object_id, kind.solidity
            if state == "waiting" and job in works:
                state = "running"
                found.works += [] if works[job].orphaned else [works[job]]
            elif state == "waiting" and job in stopped and not runs and done.issuperset(kind.before):
                state = "stopped"
                found.stopped.append(stopped[job])
            found.jobs[kind.stage][state] += 1
    return found


def mean_seconds(plan: Plan) -> dict[str, float]:
    """Return the mean wall time of a job by stage, from a sample of the journal."""
    noted = sorted(journal.names(plan.paths.results).intersection(plan.objects))
    seconds: dict[str, list[float]] = {}
    for object_id in noted[:: max(1, len(noted) // _SAMPLE_SIZE)]:
        for job in journal.ended(plan.paths.results, object_id).values():
            seconds.setdefault(job.stage, []).append(job.wall_s)
    return {stage: sum(values) / len(values) for stage, values in seconds.items()}


def seconds_left(found: Survey, means: dict[str, float], now: float | None = None) -> tuple[float, list[str]]:
    """Return the time in seconds of the jobs left, one after another, and the stages whose mean time is unknown.

    A running job counts with the rest of its stage's mean, or with zero once it has outlasted the mean.
    """
    now = time.time() if now is None else now
    left = {stage: count for stage, count in found.left().items() if count}
    seconds = sum(count * means.get(stage, 0.0) for stage, count in left.items())
    for work in found.works:
        stage = work.worker.stage
        if stage in left:
            seconds -= min(max(0.0, now - work.worker.begun), means.get(stage, 0.0))
    return seconds, sorted(set(left) - set(means))


def kinds_of(plan: Plan) -> list[Kind]:
    """Return the jobs of an object in this configuration, in the order of the chain."""
    asked = plan.config.solidities
    several = {"sounds": targets.sounds(plan), "views": targets.views(plan)}
    folder = plan.paths.at(plan.paths.object, object=_ANY_OBJECT)
    found: dict[str, Kind] = {}  # by product path
    kinds = []
    for made in jobs(plan.paths, _ANY_OBJECT):
        if made.solidity not in ("", *asked) or made.step.only not in ("", *asked):
            continue
        paths = [
            str(Path(plan.paths.at(pattern, object=_ANY_OBJECT, solidity=made.solidity)))
            for output in made.step.outputs.values()
            for pattern in several.get(output.pattern, [getattr(plan.paths, output.pattern)])
        ]
        inputs = {str(made.input(name)) for name in made.step.chained}
        kind = Kind(
            made.step.name,
            made.solidity,
            [os.path.split(os.path.relpath(path, folder)) for path in paths],
            os.path.relpath(made.record, folder),
            list(dict.fromkeys(found[path] for path in inputs)),
        )
        kinds.append(kind)
        found.update(dict.fromkeys(paths, kind))
    return kinds


def _working_and_stopped(
    begun: list[tuple[Path, Worker]], paths: Paths, runs: set[str]
) -> tuple[dict[tuple, Work], dict[tuple, str]]:
    """Return the working jobs, and the logs of failed and killed ones, both by stage, object and solidity."""
    works, stopped = {}, {}
    for file, worker in begun:
        step = BY_NAME.get(worker.stage)
        if step is None:
            continue
        wildcards = zip(step.wildcards, (worker.object, worker.solidity), strict=False)
        log = paths.at(paths.log(step.name, *step.wildcards), **dict(wildcards))
        if journal.works(file, worker):
            works[worker.job] = Work(worker, file, log, worker.run not in runs)
        else:
            stopped[worker.job] = log
    return works, stopped


def _names(folder: str) -> set[str]:
    try:
        return set(os.listdir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return set()
