"""Checks before the first job that Slurm has what a run asks for; each fails with one sentence."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from vibraverse.contract.errors import NotThere
from vibraverse.contract.texts import counted

#: Ids of the Slurm job that this process is part of, and of its array. Read at import, because Snakemake's Slurm plugin
#: deletes the variables before a run's first job.
_OWN_JOBS = {os.environ.get("SLURM_JOB_ID"), os.environ.get("SLURM_ARRAY_JOB_ID")}
#: Default delay in seconds before Snakemake's plugin first asks for the state of jobs.
_DEFAULT_FIRST_CHECK_S = 40
#: Keys of a profile with which the plugin asks the queue instead of the accounting.
_QUEUE_SETTINGS = "slurm-status-command: squeue and slurm-init-seconds-before-status-checks: 20"


class Partition(NamedTuple):
    """The resources of a partition's largest node, and the time limit of its jobs in minutes (None: no limit)."""

    memory_mb: int = 0
    gpus: int = 0
    minutes: float | None = 0


class _Asking(NamedTuple):
    """Who asks for resources: a rule, or a group of ``size`` jobs of several rules."""

    rules: str
    size: int

    @property
    def short(self) -> str:
        """The rule's name, or the words for a group."""
        return self.rules if self.size == 1 else f"a group of {self.size} jobs ({self.rules})"

    def __str__(self) -> str:
        return f"the rule {self.rules}" if self.size == 1 else self.short


def check(
    jobs: Iterable[tuple[str, Mapping, int]], folder: str | Path = ".", settings=None, attempts: int = 1
) -> None:
    """Check that Slurm answers, has what jobs ask for, and runs no earlier jobs in ``folder``.

    ``jobs`` are the rules, resources and size of each, which is more than 1 for a group. ``settings`` are the plugin's.
    If only a later one of ``attempts`` asks for too much time, print a warning.
    """
    there, default = partitions()
    no_earlier_jobs(Path(folder).resolve())
    if settings is not None:
        _check_ends_known(settings)
    asked: dict[tuple, list[int]] = {}
    for rules, resources, size in jobs:
        rule = _Asking(rules, size)
        gpus = int(resources.get("gpu") or ("gpu" in str(resources.get("gres", ""))))
        most = asked.setdefault((rule, resources.get("slurm_partition") or default or ""), [0, 0, 0])
        wanted = int(resources.get("mem_mb") or 0), gpus, int(resources.get("runtime") or 0)
        most[:] = map(max, most, wanted)
    later = {}
    for (rule, chosen), (memory_mb, gpus, minutes) in sorted(asked.items()):
        for name in chosen.split(",") if chosen else []:
            if name not in there:
                raise NotThere(
                    f"Slurm has no partition {name!r}, which {rule} asks for; set slurm_partition in the "
                    f"profile to one of: {', '.join(sorted(there))}"
                )
            _check_partition(rule, name, there, memory_mb, gpus, minutes)
            if there[name].minutes is not None and minutes * attempts > there[name].minutes:
                later.setdefault((name, there[name].minutes), []).append(rule.short)
    for (name, most), rules in sorted(later.items()):
        print(
            f"vibraverse: a job of {', '.join(rules)} that fails asks for more time each time, up to {attempts} times "
            f"as much, and would wait for ever where that is more than the {most:g} min of the partition {name}; set "
            "runtime in the profile's set-resources, or fewer retries",
            file=sys.stderr,
        )


def _check_partition(rule: _Asking, name: str, there: dict, memory_mb: int, gpus: int, minutes: int) -> None:
    """Check that a partition has what a rule asks for."""
    most = there[name]
    if gpus > most.gpus:
        others = [other for other, has in sorted(there.items()) if has.gpus >= gpus]
        raise NotThere(
            f"{rule} asks for {'a GPU' if gpus == 1 else f'{gpus} GPUs'}, but "
            + (
                f"the partition {name} has none; "
                if not most.gpus
                else f"no node of {name} has more than {most.gpus}; "
            )
            + (f"GPUs are in: {', '.join(others)}" if others else "no partition has so many")
            + f"; set slurm_partition or gpu of {rule} in the profile's set-resources"
        )
    more = (
        "; a group asks for the sum of its jobs, so lower group-components, or use `vibraverse submit`"
        if rule.size > 1
        else ""
    )
    if memory_mb > most.memory_mb:
        raise NotThere(
            f"{rule} asks for {memory_mb} MB, but the largest node of the partition {name} has {most.memory_mb} MB; "
            f"choose another partition, or set its mem_mb in the profile's set-resources{more}"
        )
    if most.minutes is not None and minutes > most.minutes:
        raise NotThere(
            f"{rule} asks for {minutes} min, but a job in the partition {name} may take {most.minutes:g}, and one that "
            "asks for more waits for ever; choose another partition, or set its runtime in the profile's "
            f"set-resources{more}"
        )


def _check_ends_known(settings) -> None:
    """Check that the plugin will learn how jobs end, from the accounting or from the queue, as ``settings`` say."""
    if shutil.which("sacct") is None:
        return  # the plugin asks squeue by itself
    accounts = _run("sacct", "-n", "-X", "-j", "1")
    if accounts.returncode == 0:
        return
    if settings.status_command == "sacct":
        raise NotThere(
            f"this cluster keeps no accounts, or they do not answer (sacct: {_last_words(accounts)}), so that the run "
            f"would never learn that a job has ended; write {_QUEUE_SETTINGS} into the profile"
        )
    kept = re.search(r"^MinJobAge\s*=\s*(\d+)", _ask("scontrol", "show", "config"), re.MULTILINE)
    first = settings.init_seconds_before_status_checks or _DEFAULT_FIRST_CHECK_S
    if kept and int(kept[1]) < 3 * first:
        raise NotThere(
            f"Slurm forgets a job {kept[1]} s after its end (MinJobAge) and keeps no accounts; the first look at jobs, "
            f"slurm-init-seconds-before-status-checks, must be below a third of that, not {first}"
        )


def _run(*command: str) -> subprocess.CompletedProcess:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 1, "", "no answer within 60 s")


def _last_words(done: subprocess.CompletedProcess) -> str:
    return (done.stderr.strip().splitlines() or ["no reason given"])[-1]


def _ask(*command: str) -> str:
    try:
        done = _run(*command)
    except FileNotFoundError:
        raise NotThere(
            f"the profile asks for Slurm, but the command {command[0]} is not on the PATH; log in to the cluster's "
            "submit node, or run without it: --workflow-profile workflow/profiles/default"
        ) from None
    if done.returncode != 0:
        raise NotThere(
            f"Slurm does not answer ({_last_words(done)}); `scontrol ping` tells more, nothing was submitted"
        )
    return done.stdout


def partitions() -> tuple[dict[str, Partition], str | None]:
    """Return the partitions by name, and the name of the default one."""
    found: dict[str, Partition] = {}
    default = None
    for line in _ask("sinfo", "-h", "-o", "%P|%m|%G|%l").splitlines():
        name, memory, gres, limit = line.split("|")
        if name.endswith("*"):
            name = default = name[:-1]
        old = found.get(name, Partition())
        found[name] = Partition(
            max(old.memory_mb, int(memory.rstrip("+"))), max(old.gpus, _gpus(gres)), _minutes(limit)
        )
    return found, default


def _gpus(gres: str) -> int:
    """Return the number of GPUs in ``gpu:type:2(S:0-1),…``; type, number and sockets may be missing."""
    devices = [device.split(":") for device in re.sub(r"\([^)]*\)", "", gres).split(",")]
    return sum(
        int(rest[-1]) if rest and rest[-1].isdigit() else 1 for kind, *rest in devices if kind == "gpu"
    )


def _minutes(limit: str) -> float | None:
    """Return the minutes of ``days-hours:minutes:seconds``; leading parts may be missing; None for no limit."""
    if not re.fullmatch(r"(\d+-)?\d+(:\d+){0,2}", limit):
        return None
    days, _, clock = limit.rpartition("-")
    parts = [0, 0, *map(int, clock.split(":"))][-3:]
    return int(days or 0) * 1440 + parts[0] * 60 + parts[1] + parts[2] / 60


def no_earlier_jobs(folder: Path) -> None:
    """Check that no Slurm job of an earlier run still writes here: it and this run would disturb each other."""
    queue = _ask("squeue", "-h", "-u", str(os.getuid()), "-t", "PENDING,RUNNING,COMPLETING", "-o", "%i|%Z")
    jobs = (line.split("|", 1) for line in queue.splitlines())
    left = [job for job, where in jobs if where == str(folder) and re.match(r"\d+", job)[0] not in _OWN_JOBS]
    if left:
        raise NotThere(
            f"an earlier run still has {counted(len(left), 'Slurm job')} in {folder}; wait for its end (`squeue --me` "
            f"shows it), or end it with `scancel {' '.join(left[:20])}`, then repeat the command"
        )


def queued_jobs() -> set[str] | None:
    """Return the ids of this user's jobs in the queue (for an array, its id); None if Slurm does not answer."""
    done = _run("squeue", "-h", "-u", str(os.getuid()), "-o", "%F")
    return set(done.stdout.split()) if done.returncode == 0 else None
