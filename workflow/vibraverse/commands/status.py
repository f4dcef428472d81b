"""``vibraverse status``: how far a run is, what works now, what was refused, and how long the rest takes."""

from __future__ import annotations

import argparse
import os
from collections import Counter

from vibraverse import guard
from vibraverse.cli import UsageError
from vibraverse.commands import counted, run_arguments, run_config
from vibraverse.config import ConfigError
from vibraverse.plan import Plan
from vibraverse.progress import Survey, mean_seconds, seconds_left, survey

#: Stopped jobs whose logs are named.
_SHOWN = 5


def main(argv: list[str]) -> int:
    """Print the state of the run that a configuration describes."""
    parser = argparse.ArgumentParser(
        prog="vibraverse status",
        parents=[run_arguments()],
        description="Say how far a run is, by the products that there are. What is out of date, and why, "
        "`snakemake -n` tells.",
    )
    chosen = parser.parse_args(argv)
    try:
        plan = Plan(run_config(chosen))
    except ConfigError as error:
        raise UsageError(str(error)) from None
    started = guard.run_since(plan.paths.results)
    found = survey(plan, started)
    print(_objects(plan, found))
    print(_stages(found))
    print(_dataset(plan))
    print(_rest(found, mean_seconds(plan), started is not None))
    return 0


def _objects(plan: Plan, found: Survey) -> str:
    """Return the counts of the objects, and of the refusals by stage and reason."""
    counts = found.objects
    lines = [
        f"{counted(len(plan.objects), 'object')}: {counts['done']} done, {counts['begun']} begun, "
        f"{counts['missing']} not begun, {counts['refused']} refused, {found.in_part} more in part"
    ]
    for (stage, reason), count in Counter(
        (row["stage"], row["reason"]) for row in found.refusals
    ).most_common():
        lines.append(f"    refused at {stage}: {reason}, {count}")
    if found.strangers:
        lines.append(
            f"    {found.strangers} more in {plan.paths.results}/objects, which the configuration does not name"
        )
    return "\n".join(lines)


def _stages(found: Survey) -> str:
    """Return a table of the jobs by stage."""
    states = ("done", "refused", "running", "stopped", "waiting")
    lines = [f"\n{'stage':<10}" + "".join(f"{state:>9}" for state in states)]
    for stage, counts in found.jobs.items():
        if counts:
            lines.append(f"{stage:<10}" + "".join(f"{counts[state]:>9}" for state in states))
    if found.stopped:
        lines.append("stopped, or failed; the next run begins them anew:")
        lines += [f"    {log}" for log in found.stopped[:_SHOWN]]
        lines += [f"    … and {len(found.stopped) - _SHOWN} more"] if len(found.stopped) > _SHOWN else []
    return "\n".join(lines)


def _dataset(plan: Plan) -> str:
    """Return which of the last products there are."""
    paths = plan.paths
    shards = [paths.at(paths.shard, shard=shard) for shard in plan.shards]
    there = sum(os.path.isfile(shard) for shard in shards)
    last = {"index": paths.dataset_record, "report": paths.report}
    ends = ", ".join(
        f"{name} {'there' if os.path.isfile(path) else 'missing'}" for name, path in last.items()
    )
    return f"\ndataset: {there} of {len(shards)} shards, {ends}"


def _rest(found: Survey, means: dict[str, float], works: bool) -> str:
    """Return how long the rest takes, by the mean times of the jobs so far."""
    state = f"A run works, on {found.running} jobs of objects." if works else "No run works."
    if not sum(found.left().values()):
        return f"{state} No jobs of objects are left."
    seconds, unknown = seconds_left(found, means)
    if not means:
        return f"{state} No job has ended yet, so the time left is not known."
    text = f"{state} Left: {_time(seconds)} for one job at a time"
    if found.running > 1:
        text += f", {_time(seconds / found.running)} for {found.running}"
    return text + (f"; without {', '.join(unknown)}, of which none has ended yet." if unknown else ".")


def _time(seconds: float) -> str:
    """Return a time with two units at most: ``2 d 3 h``, ``5 min``."""
    for unit, length, smaller, part in (("d", 86400, "h", 3600), ("h", 3600, "min", 60)):
        if seconds >= length:
            return f"{int(seconds // length)} {unit} {int(seconds % length // part)} {smaller}"
    return f"{seconds / 60:.0f} min" if seconds >= 60 else f"{seconds:.0f} s"
