"""One run at a time in a results folder, with a lock that a killed run cannot leave behind.

Snakemake's own lock is a file that stays after SIGKILL and must be removed by hand. The profiles switch it off
(``nolock``) and this one takes its place: the kernel drops it when the process ends, however it ends.
"""

from __future__ import annotations

import fcntl
import os
import sys
from pathlib import Path

from vibraverse.products import not_stored

_held = []


def only_run(results: str | Path):
    """Hold the results folder, until what is returned is closed or the process ends; or leave with exit status 1.

    Whoever holds it is named. Returns None on a file system without locks.
    """
    folder = Path(results)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / ".run.lock", "a+")  # noqa: SIM115 - stays open as long as the process lives
    except OSError as error:
        print(f"vibraverse: {not_stored(error, folder) or error}", file=sys.stderr)
        sys.exit(1)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.seek(0)
        print(
            f"vibraverse: another run (process {lock.read().strip() or 'unknown'}) is working in {folder}; "
            "wait for it to end, or stop it.",
            file=sys.stderr,
        )
        sys.exit(1)
    except OSError:
        return None  # a file system without locks: go on without one
    try:
        lock.truncate(0)
        lock.write(str(os.getpid()))
        lock.flush()
    except OSError as error:
        print(f"vibraverse: {not_stored(error, folder) or error}", file=sys.stderr)
        sys.exit(1)
    _held.append(lock)
    return lock


def run_since(results: str | Path) -> float | None:
    """Return when the run that holds a results folder began, as seconds since 1970; None where none does."""
    path = Path(results) / ".run.lock"
    try:
        with open(path, "rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return path.stat().st_mtime
    except OSError:
        return None
    return None
