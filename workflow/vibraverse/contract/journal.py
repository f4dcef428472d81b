"""The journal of a results folder: which processes work there, and the costs of the jobs that ended.

``journal/runs/…json``
    One file per run, locked by the run's process.
``journal/begun/…json``
    One file per job, locked likewise. It is deleted when the job ends, and stays if the job fails or is killed.
``journal/NAME.jsonl``
    The ended jobs of an object, a shard or a known body, one line each. For a stage with a single job, NAME is the
    stage.

The kernel drops a lock when its process ends, however it ends. So a file shows whether its process still works, across
machines too if the file system shares locks between them. Without locks, a process of this machine is looked up by its
number, and one of another machine counts as working until its file is deleted.

The environment variable :data:`RUN` names the run's file to its jobs. A stage that is run by hand writes no journal,
because the variable is not set.
"""

from __future__ import annotations

import fcntl
import json
import os
import struct
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path

#: Environment variable that names the run's file to its jobs.
RUN = "VIBRAVERSE_RUN"
#: How a job ended. A job that passes on the refusal of an input computes nothing.
DONE, REFUSED, PASSED_ON, FAILED = "done", "refused", "passed on", "failed"
#: ``struct flock`` of 64-bit Linux: type, whence, start, length, process.
_FLOCK = "hhqqi"
_LINUX = sys.platform.startswith("linux")


@dataclass(frozen=True)
class Worker:
    """A process that works or worked: where, since when (seconds since 1970), and whether it locked its file.

    A run states the shards that it may touch (None: all); a job states its run's file name and what it works on.
    """

    host: str
    process: int
    begun: float
    slurm_job: str = ""
    locked: bool = False
    shards: list[int] | None = None
    run: str = ""
    stage: str = ""
    object: str = ""
    solidity: str = ""

    def __str__(self) -> str:
        return f"process {self.process}" + ("" if self.is_here else f" on {self.host}")

    @property
    def is_here(self) -> bool:
        """Whether the process runs on this machine."""
        return self.host == os.uname().nodename

    @property
    def job(self) -> tuple[str, str, str]:
        """Stage, object and solidity."""
        return self.stage, self.object, self.solidity


@dataclass(frozen=True)
class Ended:
    """A job that ended: how, its costs including the start of its process, where, and when (seconds since 1970)."""

    stage: str
    object: str
    solidity: str
    outcome: str
    wall_s: float
    cpu_s: float
    memory_mb: float
    host: str = ""
    process: int = 0
    slurm_job: str = ""
    run: str = ""
    begun: float = 0.0
    ended: float = 0.0


class Mark:
    """The locked journal file of this process, until :meth:`remove` or the end of the process."""

    def __init__(self, folder: Path, **facts):
        folder.mkdir(parents=True, exist_ok=True)
        host, process = os.uname().nodename, os.getpid()
        # Processes in different containers may have the same number.
        self.file = folder / f"{host}-{process}-{os.urandom(3).hex()}.json"
        aside = self.file.with_name(f".{self.file.name}")
        self._descriptor: int | None = os.open(aside, os.O_RDWR | os.O_CREAT, 0o666)
        locked = _lock(self._descriptor)
        begun, slurm_job = time.time() - _age_s(), os.environ.get("SLURM_JOB_ID", "")
        self.worker = Worker(host, process, round(begun, 3), slurm_job, locked, **facts)
        try:
            os.write(self._descriptor, json.dumps(asdict(self.worker)).encode())
            os.replace(aside, self.file)
        except OSError:
            os.close(self._descriptor)
            aside.unlink()
            raise

    def remove(self) -> None:
        """Delete the file, because the work is over. Do nothing in a second call or in a fork of the process."""
        if self._descriptor is not None and os.getpid() == self.worker.process:
            self.file.unlink(missing_ok=True)
            self.release()

    def release(self) -> None:
        """Drop the lock and keep the file, as the end of the process does."""
        os.close(self._descriptor)
        self._descriptor = None


def runs_folder(results: str | Path) -> Path:
    """Return the folder that holds the files of runs."""
    return Path(results) / "journal/runs"


def begin(stage: str, object_: str, solidity: str) -> Mark | None:
    """Mark this process's job as begun; return the mark, or None if no run started the job."""
    run = os.environ.get(RUN)
    if not run:
        return None
    file = Path(run).absolute()
    return Mark(file.parent.with_name("begun"), run=file.name, stage=stage, object=object_, solidity=solidity)


def end(mark: Mark, outcome: str, cpu_s: float, memory_mb: float) -> None:
    """Record how a job ended, and delete its mark unless it failed. A full disk does not fail the job here."""
    worker, now = mark.worker, time.time()
    line = Ended(
        *worker.job, outcome, round(_age_s(), 3), round(cpu_s, 3), memory_mb, worker.host, worker.process,
        worker.slurm_job, worker.run, worker.begun, round(now, 3),
    )  # fmt: skip
    file = mark.file.parent.with_name(f"{worker.object or worker.stage}.jsonl")
    try:
        _append(file, asdict(line))
    except OSError as error:
        print(f"what this job took is not noted in {file}: {error.strerror}", file=sys.stderr)
    if outcome != FAILED:
        mark.remove()


def _append(file: Path, record: dict) -> None:
    """Append a line to a file to which other jobs may append.

    On a local disk, one write with O_APPEND is atomic. NFS writes at the end that it has cached; taking a lock makes
    it refresh that.
    """
    descriptor = os.open(file, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
    try:
        with suppress(OSError):
            fcntl.lockf(descriptor, fcntl.LOCK_EX)
        os.write(descriptor, f"{json.dumps(record, ensure_ascii=False)}\n".encode())
    finally:
        os.close(descriptor)


def names(results: str | Path) -> set[str]:
    """Return the names of the objects, shards, known bodies and stages that have ended jobs."""
    files = _listed(Path(results) / "journal", ".jsonl")
    return {file.name.removesuffix(".jsonl") for file in files}


def ended(results: str | Path, name: str) -> dict[tuple[str, str, str], Ended]:
    """Return the last successful or refused end of each job of an object; skip lines that a crash cut off."""
    text = Path(results, "journal", f"{name}.jsonl").read_text(encoding="utf-8", errors="replace")
    lines = filter(None, (_parsed(Ended, line) for line in text.splitlines()))
    return {(one.stage, one.object, one.solidity): one for one in lines if one.outcome != FAILED}


def runs(results: str | Path) -> Iterator[tuple[Path, Worker]]:
    """Yield the runs that work and those that were killed, with their files."""
    yield from _marked(runs_folder(results))


def working_runs(results: str | Path) -> dict[str, Worker]:
    """Return the runs that work, by file name."""
    return {file.name: run for file, run in runs(results) if works(file, run)}


def begun(results: str | Path) -> Iterator[tuple[Path, Worker]]:
    """Yield the jobs that work, those that failed and those that were killed, with their files."""
    yield from _marked(Path(results) / "journal/begun")


def works(file: Path, worker: Worker) -> bool:
    """Return whether the process that a file belongs to still works."""
    if worker.locked:
        with suppress(OSError):
            return _is_locked(file)
    return not worker.is_here or _is_alive(worker.process)


def _lock(descriptor: int) -> bool:
    """Lock a file that no other process has open; return whether the file system allows it.

    The lock belongs to the open file description. A lock of the process would be dropped as soon as the process opened
    the file again and closed it.
    """
    if not _LINUX:
        return False
    try:
        fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, _whole_file(fcntl.F_WRLCK))
    except OSError:
        return False
    return True


def _is_locked(file: Path) -> bool:
    try:
        with open(file, "rb") as lock:
            found = fcntl.fcntl(lock, fcntl.F_OFD_GETLK, _whole_file(fcntl.F_WRLCK))
    except FileNotFoundError:
        return False
    return struct.unpack(_FLOCK, found)[0] != fcntl.F_UNLCK


def _whole_file(kind: int) -> bytes:
    return struct.pack(_FLOCK, kind, os.SEEK_SET, 0, 0, 0)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _marked(folder: Path) -> Iterator[tuple[Path, Worker]]:
    for file in _listed(folder, ".json"):
        with suppress(FileNotFoundError):
            worker = _parsed(Worker, file.read_text(encoding="utf-8"))
            if worker is not None:
                yield file, worker


def _listed(folder: Path, suffix: str) -> Iterable[Path]:
    try:
        found = sorted(os.listdir(folder))
    except FileNotFoundError:
        return []
    return [folder / name for name in found if name.endswith(suffix) and not name.startswith(".")]


def _parsed(kind: type, text: str):
    """Return a record of a kind from JSON, without keys of later versions; None if the text is no such record."""
    try:
        values = json.loads(text)
        return kind(**{one.name: values[one.name] for one in fields(kind) if one.name in values})
    except (ValueError, TypeError):
        return None


def _age_s() -> float:
    """Return the age of this process in seconds; outside Linux, the time since this module was imported."""
    if not _LINUX:
        return time.perf_counter() - _IMPORTED
    with open("/proc/self/stat", encoding="ascii", errors="replace") as file:
        ticks = int(file.read().rpartition(")")[2].split()[19])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


_IMPORTED = time.perf_counter()
