"""How far a run is: which products of the configured objects there are, which jobs work now, and what is left.

Looks at names, not into files, but for the few bytes that tell a refusal from a product.
"""

from __future__ import annotations

import csv
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from vibraverse.contract.refusal import is_refusal
from vibraverse.flow import targets
from vibraverse.flow.chain import refusals_of
from vibraverse.flow.plan import Plan
from vibraverse.flow.steps import CHAIN
from vibraverse.machine import locks
from vibraverse.upkeep.lineage import Made, jobs

#: Benchmark files of a stage that are read for its mean time.
_SAMPLED = 40
#: Stands for an object in paths that serve for all objects.
_ANY = "_"


@dataclass(frozen=True, eq=False)
class Kind:
    """A job that every object has: its files and, among them, its record, below the object's folder; its log and its
    benchmark."""

    stage: str
    solidity: str
    files: list[tuple[str, str]]
    record: str
    log: str
    benchmark: str
    before: list[Kind]


@dataclass(frozen=True)
class Work:
    """A job that works now: its log, when it began, and its process where the run that started it is gone.

    Stages say little before they end, so the log tells the begin.
    """

    stage: str
    log: str
    since: float
    orphan: int | None = None


@dataclass
class Survey:
    """What there is of the configured objects.

    ``objects`` counts them by state: ``done``, ``refused`` (nothing is left), ``begun`` and ``missing``; of
    ``body_by_body`` of the refused ones each body was refused, and ``in_part`` counts those of which only some body is.
    ``jobs`` counts by stage the jobs that are ``done``, ``refused``, ``running``, ``stopped`` (begun, and nothing works
    on them) and ``waiting``. ``works`` are those that run, and those that run of what is no object's alone.
    ``refusals`` are rows of ``refusals.tsv``; ``stopped`` names the logs of stopped jobs; ``strangers`` counts objects
    that the configuration does not name.
    """

    objects: Counter = field(default_factory=Counter)
    in_part: int = 0
    body_by_body: int = 0
    works: list[Work] = field(default_factory=list)
    jobs: dict[str, Counter] = field(default_factory=lambda: {step.name: Counter() for step in CHAIN})
    refusals: list[dict] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)
    strangers: int = 0

    def left(self) -> dict[str, int]:
        """Return how many jobs of each stage are not done."""
        return {
            stage: counts["running"] + counts["stopped"] + counts["waiting"]
            for stage, counts in self.jobs.items()
        }

    @property
    def running(self) -> int:
        """How many jobs of objects the run works on now."""
        return sum(work.stage in self.jobs and work.orphan is None for work in self.works)


def survey(plan: Plan, started: float | None) -> Survey:
    """Return what there is of all objects; ``started`` is when the run that works now began, None where none does."""
    found = Survey()
    kinds = _kinds(plan)
    places = {place for kind in kinds for place, _ in kind.files}
    root = os.path.dirname(plan.paths.at(plan.paths.object, object=_ANY))
    there = set(_names(root))
    found.strangers = len(there - set(plan.objects))
    outputs = locks.outputs()
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
            if state == "waiting" and done.issuperset(kind.before):
                log, ended = (
                    path.replace(f"/{_ANY}/", f"/{object_id}/") for path in (kind.log, kind.benchmark)
                )
                state, work = _begun(kind.stage, log, ended, started, outputs)
                found.stopped += [log] if state == "stopped" else []
                found.works += [work] if work else []
            found.jobs[kind.stage][state] += 1
    for stage, product, log, ended in _last(plan):
        if not os.path.isfile(product):
            work = _begun(stage, log, ended, started, outputs)[1]
            found.works += [work] if work else []
    return found


def mean_seconds(plan: Plan) -> dict[str, float]:
    """Return the mean wall time of a job by stage, from a sample of the benchmarks that Snakemake wrote."""
    written = [object_id for object_id in plan.objects if os.path.isdir(_benchmarks(plan, object_id))]
    seconds: dict[str, list[float]] = {}
    for object_id in written[:: max(1, len(written) // _SAMPLED)]:
        for path in Path(_benchmarks(plan, object_id)).glob("*.tsv"):
            with open(path, encoding="utf-8") as file:
                rows = list(csv.DictReader(file, delimiter="\t"))
            seconds.setdefault(path.name.split(".")[0], []).extend(float(row["s"]) for row in rows)
    return {stage: sum(values) / len(values) for stage, values in seconds.items() if values}


def seconds_left(found: Survey, means: dict[str, float], now: float | None = None) -> tuple[float, list[str]]:
    """Return how long the jobs that are left take one after another, and the stages of which no time is known.

    A job that runs has the rest of its stage's mean before it; one that outlasts the mean counts no more.
    """
    now = time.time() if now is None else now
    left = {stage: count for stage, count in found.left().items() if count}
    seconds = sum(count * means.get(stage, 0.0) for stage, count in left.items())
    for work in found.works:
        if work.stage in left:
            seconds -= min(max(0.0, now - work.since), means.get(work.stage, 0.0))
    return seconds, sorted(set(left) - set(means))


def _kinds(plan: Plan) -> list[Kind]:
    """Return the jobs of an object in this configuration, in the order of the chain."""
    asked = plan.config.solidities
    several = {"sounds": targets.sounds(plan), "views": targets.views(plan)}
    folder = plan.paths.at(plan.paths.object, object=_ANY)
    found: dict[str, Kind] = {}  # by the files it makes
    kinds = []
    for made in jobs(plan.paths, _ANY):
        if made.solidity not in ("", *asked) or made.step.only not in ("", *asked):
            continue
        paths = [
            str(Path(plan.paths.at(pattern, object=_ANY, solidity=made.solidity)))
            for output in made.step.outputs.values()
            for pattern in several.get(output.pattern, [getattr(plan.paths, output.pattern)])
        ]
        inputs = {str(made.input(name)) for name in made.step.chained}
        kind = Kind(
            made.step.name,
            made.solidity,
            [os.path.split(os.path.relpath(path, folder)) for path in paths],
            os.path.relpath(made.record, folder),
            _written(plan.paths.log, plan, made),
            _written(plan.paths.benchmark, plan, made),
            list(dict.fromkeys(found[path] for path in inputs)),
        )
        kinds.append(kind)
        found.update(dict.fromkeys(paths, kind))
    return kinds


def _written(pattern: Callable, plan: Plan, made: Made) -> str:
    """Return the path of what Snakemake writes about a job: its log or its benchmark."""
    return plan.paths.at(pattern(made.step.name, *made.step.wildcards), object=_ANY, solidity=made.solidity)


def _benchmarks(plan: Plan, object_id: str) -> str:
    return os.path.dirname(plan.paths.at(plan.paths.benchmark("sources", "object"), object=object_id))


def _last(plan: Plan) -> Iterator[tuple[str, str, str, str]]:
    """Yield stage, product, log and benchmark of the jobs that are not of one object."""
    paths = plan.paths
    for shard in plan.shards:
        patterns = (paths.shard, paths.log("dataset", "shard"), paths.benchmark("dataset", "shard"))
        yield "dataset", *(paths.at(pattern, shard=shard) for pattern in patterns)
    for stage, product in (("index", paths.dataset_record), ("report", paths.report)):
        yield stage, product, paths.log(stage), paths.benchmark(stage)


def _begun(
    stage: str, log: str, benchmark: str, started: float | None, outputs: dict[str, int]
) -> tuple[str, Work | None]:
    """Return the state of a job whose inputs are there and whose products are not, by its log and benchmark.

    One that ended has its benchmark written last: then its products were deleted to be made again. One of a run that
    was killed may still compute: its log is among the ``outputs`` of processes.
    """
    begun, ended = _modified(log), _modified(benchmark)
    if begun is None or (ended is not None and ended >= begun):
        return "waiting", None
    if started is not None and begun >= started:
        return "running", Work(stage, log, begun)
    orphan = outputs.get(os.path.realpath(log))
    if orphan:
        return "running", Work(stage, log, begun, orphan)
    return "stopped" if started is None else "waiting", None


def _modified(path: str) -> float | None:
    """Return when a file was last written, None where there is none."""
    try:
        return os.stat(path).st_mtime
    except FileNotFoundError:
        return None


def _names(folder: str) -> set[str]:
    try:
        return set(os.listdir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return set()
