"""The lock of a run: one run at a time for each part of a results folder, and no stale lock after a kill.

Snakemake's own lock is a file that stays after SIGKILL and must be removed by hand. The profiles switch it off
(``nolock``), and this lock replaces it: the kernel drops it when the process ends, however it ends.

Byte ``s`` of the lock file stands for shard ``s`` of the dataset and the objects in it. A slice locks the bytes of its
shards; any other run locks all possible bytes. So runs that share an object exclude each other, and slices do not.

On a file system without locks, runs find each other by their files in the journal. Each writes its own first and then
looks for others. Of two runs that begin at the same moment, at most one continues.
"""

from __future__ import annotations

import atexit
import fcntl
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TextIO

from vibraverse.contract import journal
from vibraverse.contract.journal import Mark, Worker
from vibraverse.contract.products import not_stored

#: The locks of this process. Python would close a lock file, and so drop the lock, without a reference to it.
_held: list[Hold] = []
#: Polling interval in seconds, for the wait for orphaned jobs.
_POLL_INTERVAL_S = 1.0


class Hold:
    """A run's lock on a results folder, until it is closed or its process ends; ``file`` is its file in the journal."""

    def __init__(self, mark: Mark, lock: TextIO):
        self.file = mark.file
        self._mark, self._lock = mark, lock
        atexit.register(mark.remove)
        _held.append(self)

    def close(self) -> None:
        """Release the lock."""
        self._mark.remove()
        self._lock.close()
        _held.remove(self)

    def __enter__(self) -> Hold:
        return self

    def __exit__(self, *_) -> None:
        self.close()


def lock_file(results: str | Path) -> Path:
    """Return the file that the runs of a results folder lock."""
    return Path(results) / ".run.lock"


def only_run(results: str | Path, shards: Iterable[int] | None = None) -> Hold:
    """Lock the shards (None: everything) of a results folder.

    If another process holds one of them, or the folder cannot be written, print a message and exit with status 1.
    """
    folder, parts = Path(results), None if shards is None else sorted(shards)
    try:
        mark = Mark(journal.runs_folder(folder), shards=parts)
        lock = open(lock_file(folder), "a+")  # noqa: SIM115 - stays open as long as the process lives
    except OSError as error:
        print(f"vibraverse: {not_stored(error, folder) or error}", file=sys.stderr)
        sys.exit(1)
    free, without = True, ""
    try:
        for shard, count in [(0, 0)] if parts is None else [(shard, 1) for shard in parts]:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB, count, shard)
    except (BlockingIOError, PermissionError):  # the file system decides which of the two it raises
        free = False
    except OSError as error:
        without = error.strerror or str(error)
    others = [] if free and not without else _others(folder, mark)
    if others or not free:
        mark.remove()
        lock.close()
        print(f"vibraverse: {_taken(folder, parts, others, without)}", file=sys.stderr)
        sys.exit(1)
    if without:
        print(
            f"vibraverse: {folder} is on a file system without locks ({without}). Runs see each other by their files "
            f"in {mark.file.parent} instead; when a machine crashes, delete those of its runs.",
            file=sys.stderr,
        )
    return Hold(mark, lock)


def _others(folder: Path, mark: Mark) -> list[tuple[Path, Worker]]:
    """Return the other runs that work on a shard of the run that owns ``mark``."""
    found = []
    for file, run in journal.runs(folder):
        if file == mark.file or not journal.works(file, run):
            continue
        if None in (run.shards, mark.worker.shards) or set(run.shards) & set(mark.worker.shards):
            found.append((file, run))
    return found


def _taken(folder: Path, parts: list[int] | None, others: list[tuple[Path, Worker]], without: str) -> str:
    """Return the sentence about the run that already works there."""
    who = others[0][1] if others else "process unknown"
    on = "" if parts is None else " on the same objects"
    said = f"another run ({who}) is working in {folder}{on}; wait for it to end, or stop it."
    if without:
        said += (
            f" This file system has no locks ({without}): if that run is gone already, delete {others[0][0]}."
        )
    return said


def orphans(results: str | Path, names: Iterable[str] | None = None) -> list[tuple[Path, Worker]]:
    """Return the orphaned jobs that still work; delete the files of the other orphaned jobs and of killed runs.

    ``names`` are the objects and shards to look at (None: all); no other run may work on them.
    """
    wanted = None if names is None else set(names)
    begun = list(
        journal.begun(results)
    )  # before the runs, because a run's file exists before those of its jobs
    runs, found = set(), []
    for file, run in journal.runs(results):
        if journal.works(file, run):
            runs.add(file.name)
        else:
            file.unlink(missing_ok=True)
    for file, job in begun:
        if job.run in runs or (wanted is not None and job.object not in wanted):
            continue
        if journal.works(file, job):
            found.append((file, job))
        else:
            file.unlink(missing_ok=True)
    return found


def wait_for(jobs: list[tuple[Path, Worker]]) -> None:
    """Wait until orphaned jobs have ended, and print a line for each.

    A job that starts while its orphan still works computes in vain, and both may write the same files.
    """
    for file, job in jobs:
        what = " of ".join(filter(None, (job.stage, job.object)))
        print(
            f"vibraverse: {what} is still computed by {job}, whose run was killed; this run goes on when that has "
            f"ended. To end it: {ending([(file, job)])}",
            file=sys.stderr,
            flush=True,
        )
    while jobs := [(file, job) for file, job in jobs if journal.works(file, job)]:
        time.sleep(_POLL_INTERVAL_S)


def ending(jobs: list[tuple[Path, Worker]]) -> str:
    """Return the commands that end jobs, or the Slurm jobs that contain them."""
    scancel = [*dict.fromkeys(job.slurm_job for _, job in jobs if job.slurm_job)]
    commands = [f"`scancel {' '.join(scancel)}`"] if scancel else []
    alone = [job for _, job in jobs if not job.slurm_job]
    for host in dict.fromkeys(job.host for job in alone):
        on = [job for job in alone if job.host == host]
        where = "" if on[0].is_here else f" on {host}"
        commands.append(f"`kill {' '.join(str(job.process) for job in on)}`{where}")
    gone = [str(file) for file, job in jobs if not (job.locked or job.is_here)]
    unsure = (
        f"; where it is gone already, `rm {' '.join(gone)}` (no locks tell of other machines)" if gone else ""
    )
    return " and ".join(commands) + unsure
