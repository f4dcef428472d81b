"""One run at a time for each part of a results folder, with locks that a killed run cannot leave behind.

Snakemake's own lock is a file that stays after SIGKILL and must be removed by hand. The profiles switch it off
(``nolock``) and this one takes its place: the kernel drops it when the process ends, however it ends.

Byte ``s`` of the lock file stands for shard ``s`` of the dataset and the objects in it. A slice locks the bytes of its
shards, any other run all bytes there could be. So runs that share an object exclude each other, and slices do not.
"""

from __future__ import annotations

import fcntl
import os
import struct
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from vibraverse.contract.products import not_stored

#: ``struct flock`` of 64-bit Linux: type, whence, start, length, process.
_FLOCK = "hhqqi"
_held = []
#: The folder of logs that are slices' own, not a job's.
_SLICES = "slices"
#: How often it is looked whether a job has ended.
_AGAIN_S = 1.0


def lock_file(results: str | Path) -> Path:
    """Return the file that the runs of a results folder lock."""
    return Path(results) / ".run.lock"


def holder(lock: int, shard: int = 0, count: int = 0) -> int | None:
    """Return the other process that keeps ``count`` shards (0: all) from being locked; None where none does.

    ``lock`` is an open lock file. Other systems than Linux do not tell.
    """
    if not sys.platform.startswith("linux"):
        return None
    asked = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, shard, count, 0)
    kind, _, _, _, process = struct.unpack(_FLOCK, fcntl.fcntl(lock, fcntl.F_GETLK, asked))
    return None if kind == fcntl.F_UNLCK else process


def only_run(results: str | Path, shards: Iterable[int] | None = None):
    """Hold the shards (None: everything) of a results folder, until what is returned is closed or the process ends.

    Where another process holds one of them, or the folder cannot be written, that is said and the exit status is 1.
    Returns None on a file system without locks.
    """
    folder = Path(results)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(lock_file(folder), "a+")  # noqa: SIM115 - stays open as long as the process lives
    except OSError as error:
        print(f"vibraverse: {not_stored(error, folder) or error}", file=sys.stderr)
        sys.exit(1)
    parts = [(0, 0)] if shards is None else [(shard, 1) for shard in shards]
    try:
        for shard, count in parts:
            fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB, count, shard)
    except (BlockingIOError, PermissionError):  # which of the two is up to the file system
        process = holder(lock.fileno(), shard, count)
        print(
            f"vibraverse: another run (process {process or 'unknown'}) is working in {folder}"
            f"{'' if shards is None else ' on the same objects'}; wait for it to end, or stop it.",
            file=sys.stderr,
        )
        sys.exit(1)
    except OSError:
        return None  # a file system without locks: go on without one
    os.utime(lock.fileno())  # when the run began
    _held.append(lock)
    return lock


def outputs() -> dict[str, int]:
    """Return the files that processes here have as their standard output, each with the process (the lowest number).

    A job's is its log, also when the run that started it is gone. Other systems than Linux do not tell, nor do they of
    other users' processes, nor of other machines.
    """
    found: dict[str, int] = {}
    for entry in Path("/proc").glob("[0-9]*") if sys.platform.startswith("linux") else ():
        with suppress(OSError):  # it has ended, or is not ours
            file, process = os.readlink(entry / "fd/1"), int(entry.name)
            found[file] = min(process, found.get(file, process))
    return found


def wait_for_jobs_of_gone_runs(logs: str | Path, names: Iterable[str] | None = None) -> None:
    """Wait until no job here works any more that a killed run has left; say so, once for each.

    ``logs`` is the folder with the jobs' logs, ``names`` are its folders that are looked at (None: all), in which no
    other run may work. A job that is begun anew beside an old one computes in vain, and may meet what that one writes.
    """
    said: set[tuple[str, int]] = set()
    while left := set(_writing_below(logs, None if names is None else set(names))):
        for log, process in sorted(left - said):
            print(
                f"vibraverse: a job of a run that is gone still computes ({log}); this run goes on when that has "
                f"ended, or is ended with `kill {process}`",
                file=sys.stderr,
                flush=True,
            )
        said |= left
        time.sleep(_AGAIN_S)


def _writing_below(logs: str | Path, names: set[str] | None) -> Iterable[tuple[str, int]]:
    """Yield the logs that processes write, each with the lowest process, besides where this one's output goes."""
    own = {os.path.realpath(f"/proc/self/fd/{number}") for number in (1, 2)}
    for file, process in outputs().items():
        if file in own or not file.startswith(f"{os.path.realpath(logs)}{os.sep}"):
            continue
        name = os.path.relpath(file, os.path.realpath(logs))
        folder = os.path.dirname(name)
        if folder != _SLICES and (names is None or folder in names):
            yield os.path.join(logs, name), process


def run_since(results: str | Path) -> float | None:
    """Return when the latest run that holds a part of a results folder began, as seconds since 1970.

    None where no other process does. Not for a process that holds a part itself: closing the file would let it go.
    """
    try:
        with open(lock_file(results), "rb") as lock:
            return None if holder(lock.fileno()) is None else os.fstat(lock.fileno()).st_mtime
    except OSError:
        return None
