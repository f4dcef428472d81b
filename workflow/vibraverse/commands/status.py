"""``vibraverse status``: show the progress of a run, its running jobs, its refusals and the time left."""

from __future__ import annotations

import argparse
import math
import os
import time
from collections import Counter

from vibraverse.commands import run_arguments, run_config
from vibraverse.contract.texts import and_more, counted, duration
from vibraverse.flow.plan import Plan
from vibraverse.machine.locks import ending
from vibraverse.upkeep.progress import Survey, Work, mean_seconds, seconds_left, survey

#: Running jobs whose logs are named, and as many stopped ones.
_SHOWN_JOBS = 5


def main(argv: list[str]) -> int:
    """Print the state of the run that a configuration describes."""
    parser = argparse.ArgumentParser(
        prog="vibraverse status",
        parents=[run_arguments()],
        description="Show how far a run is, by the products that exist. `snakemake -n` tells which are stale, and why.",
    )
    chosen = parser.parse_args(argv)
    plan = Plan(run_config(chosen))
    found = survey(plan)
    print(_objects(plan, found))
    means = mean_seconds(plan)
    print(_stages(found, means))
    print(_dataset(plan))
    print(_rest(found, means))
    return 0


def _objects(plan: Plan, found: Survey) -> str:
    """Return the counts of objects by state, and of refusals by stage and reason."""
    counts = found.objects
    lines = [
        f"{counted(len(plan.objects), 'object')}: {counts['done']} done, {counts['begun']} begun, "
        f"{counts['missing']} not begun, {counts['refused']} refused"
    ]
    lines += [_refused(found)] if found.refusals else []
    for (stage, reason, what), count in Counter(
        (row["stage"], row["reason"], "body" if row["solidity"] else "object") for row in found.refusals
    ).most_common():
        things = "bodies" if what == "body" and count != 1 else counted(count, what).split()[1]
        lines.append(f"    refused at {stage}: {reason}, {count} {things}")
    if found.strangers:
        lines.append(
            f"    {found.strangers} more in {plan.paths.results}/objects, which the configuration does not name"
        )
    return "\n".join(lines)


def _refused(found: Survey) -> str:
    """Return how many objects are refused as a whole and how many in part."""
    whole, parts = found.objects["refused"], []
    if whole:
        singly = f" ({found.body_by_body} of them body by body)" if found.body_by_body else ""
        parts.append(f"{counted(whole, 'object')} whole{singly}")
    if found.in_part:
        others = "others" if found.in_part > 1 else "other"
        of = f"{found.in_part} {others}" if whole else counted(found.in_part, "object")
        parts.append(
            f"one of the two bodies of {of}, which {'go' if found.in_part > 1 else 'goes'} on with the rest"
        )
    return f"refused: {', and '.join(parts)}"


def _stages(found: Survey, means: dict[str, float]) -> str:
    """Return a table of the jobs by stage."""
    states = ("done", "refused", "running", "stopped", "waiting")
    lines = [f"\n{'stage':<10}" + "".join(f"{state:>9}" for state in states)]
    for stage, counts in found.jobs.items():
        if counts:
            lines.append(f"{stage:<10}" + "".join(f"{counts[state]:>9}" for state in states))
    if found.works:
        lines.append("running, the longest first:")
        works = sorted(found.works, key=lambda work: work.worker.begun)
        lines += [_work(work, means) for work in works[:_SHOWN_JOBS]]
        lines += [f"    {more}" for more in and_more(len(works), _SHOWN_JOBS)]
    if found.stopped:
        lines.append("stopped, or failed; the next run begins them anew:")
        stopped = [*found.stopped[:_SHOWN_JOBS], *and_more(len(found.stopped), _SHOWN_JOBS)]
        lines += [f"    {line}" for line in stopped]
    return "\n".join(lines)


def _work(work: Work, means: dict[str, float]) -> str:
    """Return the line of a running job: its start, its time so far and on average, its log."""
    worker = work.worker
    begun = time.localtime(worker.begun)
    today = begun[:3] == time.localtime()[:3]
    since = time.strftime("%H:%M" if today else "%Y-%m-%d %H:%M", begun)
    mean = f", {duration(means[worker.stage])} on average" if worker.stage in means else ""
    where = "" if worker.is_here else f", on {worker.host}"
    where = f", {worker} of a run that is gone" if work.orphaned else where
    lasts = duration(time.time() - worker.begun)
    return f"    {worker.stage} since {since} ({lasts}{mean}){where}: {work.log}"


def _dataset(plan: Plan) -> str:
    """Return which of the last products exist."""
    paths = plan.paths
    shards = [paths.at(paths.shard, shard=shard) for shard in plan.shards]
    there = sum(os.path.isfile(shard) for shard in shards)
    last = {"index": paths.dataset_record, "report": paths.report}
    ends = ", ".join(
        f"{name} {'there' if os.path.isfile(path) else 'missing'}" for name, path in last.items()
    )
    return f"\ndataset: {there} of {len(shards)} shards, {ends}"


def _rest(found: Survey, means: dict[str, float]) -> str:
    """Return the time left, from the mean times of the jobs so far."""
    state = "No run works."
    if found.runs:
        runs = "A run works" if found.runs == 1 else f"{found.runs} runs work"
        state = f"{runs}, on {counted(found.running, 'job')} of objects."
    orphans = [(work.file, work.worker) for work in found.works if work.orphaned]
    if orphans:
        computes, its, it = ("computes", "its", "it") if len(orphans) == 1 else ("compute", "their", "them")
        state += (
            f" {counted(len(orphans), 'job')} of a run that is gone still {computes}: before the next run "
            f"wait for {its} end, or end {it} with {ending(orphans)}."
        )
    if not sum(found.left().values()):
        return f"{state} No jobs of objects are left."
    seconds, unknown = seconds_left(found, means)
    if not any(count and stage in means for stage, count in found.left().items()):
        which = f" of {', '.join(unknown)}" if means else ""
        return f"{state} No job{which} has ended yet, so the time left is not known."
    text = f"{state} Left: {duration(seconds)} for one job at a time"
    if found.running > 1:
        text += f", {duration(seconds / found.running)} for {found.running}"
    outlast = sum(
        time.time() - work.worker.begun > means.get(work.worker.stage, math.inf) for work in found.works
    )
    if outlast:
        take = "takes" if outlast == 1 else "take"
        text += f"; more, because {counted(outlast, 'job')} already {take} longer than on average"
    return text + (f"; not counting {', '.join(unknown)}, where no job has ended yet." if unknown else ".")
