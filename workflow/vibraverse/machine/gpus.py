"""Claims on GPUs, for several jobs on one host.

Snakemake counts GPUs on a workstation (``--resources gpu=2``), but does not assign them; two jobs that both take the
first run out of its memory. Here a job *claims* devices: it locks a file named after each device's UUID, and sees only
those devices. The kernel drops the locks when the processes that hold them end, however they end. If a scheduler has
chosen already (Slurm sets ``CUDA_VISIBLE_DEVICES``), only the devices that it shows are claimed. NVIDIA only.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from vibraverse.contract.errors import NotThere

VISIBLE = "CUDA_VISIBLE_DEVICES"
#: Environment variable with the UUIDs that this program or a parent of it has claimed.
CLAIMED = "VIBRAVERSE_GPUS_CLAIMED"
#: Environment variable for the folder of lock files, and its default: the same for all users of a host whatever their
#: TMPDIR, and visible in containers.
LOCKS, _DEFAULT_LOCKS = "VIBRAVERSE_GPU_LOCKS", "/tmp/vibraverse-gpus"
_QUERY = (
    "nvidia-smi",
    "--query-gpu=index,uuid,name,memory.total,memory.used",
    "--format=csv,noheader,nounits",
)
#: Polling interval in seconds, for a job that waits for GPUs.
_POLL_INTERVAL_S = 1.0


class NoGPU(NotThere):
    """Fewer GPUs than requested, at all or in time; the message includes the remedy."""


@dataclass(frozen=True)
class GPU:
    """A device as ``nvidia-smi`` reports it; memory in MiB."""

    index: int
    uuid: str
    name: str
    memory_mb: int
    used_mb: int


def visible() -> list[GPU]:
    """Return the GPUs that this process may use, in the order of ``nvidia-smi``; ``[]`` without a driver."""
    try:
        done = subprocess.run(_QUERY, capture_output=True, text=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return []
    if done.returncode != 0:
        return []
    found = []
    for line in done.stdout.splitlines():
        index, uuid, name, *memory = (part.strip() for part in line.split(","))
        # A GPU that shares the processor's memory reports none of its own.
        total, used = (int(words) if words.isdigit() else 0 for words in memory)
        found.append(GPU(int(index), uuid, name, total, used))
    shown = os.environ.get(VISIBLE)
    return found if shown is None else _shown(found, shown)


def _shown(gpus: list[GPU], shown: str) -> list[GPU]:
    """Return the GPUs that ``CUDA_VISIBLE_DEVICES`` lists, by number or by the beginning of a UUID.

    Like CUDA, ignore the first invalid or repeated device and everything after it.
    """
    chosen = []
    for word in filter(None, (word.strip() for word in shown.split(","))):
        if word.startswith("MIG-"):  # a part of a device, chosen by a scheduler
            chosen.append(GPU(-1, word, "part of a GPU (MIG)", 0, 0))
            continue
        matching = [gpu for gpu in gpus if word == str(gpu.index) or gpu.uuid.startswith(word)]
        if len(matching) != 1 or matching[0] in chosen:
            break
        chosen += matching
    return chosen


def _folder() -> Path:
    folder = Path(os.environ.get(LOCKS) or _DEFAULT_LOCKS)
    with suppress(FileExistsError):
        folder.mkdir(parents=True)
        folder.chmod(0o1777)
    return folder


def _lock(gpu: GPU, kind: int = fcntl.LOCK_EX) -> int | None:
    """Return the descriptor of a locked file that claims a device; None if another process holds the lock."""
    path = _folder() / f"{gpu.uuid.replace('/', '_')}.lock"
    with suppress(OSError):
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDONLY, 0o666))
        path.chmod(0o666)
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    return handle


def claimed(gpu: GPU) -> bool:
    """Return whether any process has claimed a device."""
    handle = _lock(gpu, fcntl.LOCK_SH)
    if handle is not None:
        os.close(handle)
    return handle is None


class Claim:
    """A context that holds ``count`` GPUs, the idlest unclaimed ones; it waits up to ``patience`` seconds for them.

    Within it, ``CUDA_VISIBLE_DEVICES`` lists them by UUID; for a count of 0 it is empty. Enter it before CUDA starts.
    With ``inherited``, a program that this process executes keeps holding them, and so do its children. Raises
    :class:`NoGPU` if there are too few, or if too few are freed in time.
    """

    def __init__(self, count: int = 1, patience: float = float("inf"), inherited: bool = False):
        self._count, self._patience, self._inherited = count, patience, inherited
        self._handles: list[int] = []

    def __enter__(self) -> list[GPU]:
        gpus = self._wait() if self._count else []
        self._before = {name: os.environ.get(name) for name in (VISIBLE, CLAIMED)}
        os.environ[VISIBLE] = os.environ[CLAIMED] = ",".join(gpu.uuid for gpu in gpus)
        return gpus

    def _wait(self) -> list[GPU]:
        """Return the GPUs as soon as they are claimed."""
        gpus = enough_of(self._count)
        mine = set(filter(None, os.environ.get(CLAIMED, "").split(",")))
        if mine and mine >= {gpu.uuid for gpu in gpus}:
            raise NoGPU("the GPUs are claimed already by the command that this one runs in; claim them once")
        ends, said = time.monotonic() + self._patience, False
        while not (gpus := self._take(gpus)):
            if time.monotonic() >= ends:
                raise NoGPU(
                    f"{_words(self._count)} did not come free in {self._patience:g} s; `vibraverse gpus` shows which "
                    "are claimed"
                )
            if not said:
                print(
                    f"waiting for {_words(self._count)} that no other job has claimed",
                    file=sys.stderr,
                    flush=True,
                )
                said = True
            time.sleep(_POLL_INTERVAL_S)
            gpus = visible()
        return gpus

    def _take(self, gpus: Iterable[GPU]) -> list[GPU]:
        """Lock ``count`` GPUs, the idlest first, or none at all: two partial claims would block each other."""
        taken = []
        for gpu in sorted(gpus, key=lambda gpu: (gpu.used_mb, gpu.index)):
            handle = _lock(gpu)
            if handle is None:
                continue
            os.set_inheritable(handle, self._inherited)
            self._handles.append(handle)
            taken.append(gpu)
            if len(taken) == self._count:
                return taken
        self._release()
        return []

    def _release(self) -> None:
        while self._handles:
            os.close(self._handles.pop())

    def __exit__(self, *_) -> None:
        self._release()
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def enough_of(count: int) -> list[GPU]:
    """Return the visible GPUs; raise :class:`NoGPU` if there are fewer than ``count``, claimed or not."""
    gpus = visible()
    if len(gpus) >= count:
        return gpus
    shown = os.environ.get(VISIBLE)
    if shown is not None:
        raise NoGPU(
            f"{_words(count)} asked for, but {VISIBLE}={shown!r} shows {len(gpus)}; ask for fewer, or "
            "change the variable"
        )
    if gpus:
        raise NoGPU(
            f"{_words(count)} asked for, but this machine has {len(gpus)}; ask for fewer, or run elsewhere"
        )
    raise NoGPU(
        f"{_words(count)} asked for, but nvidia-smi finds no GPU here; run on a machine that has one "
        "(in a container with --nv), or let the job run on the CPU"
    )


def _words(count: int) -> str:
    return "a GPU" if count == 1 else f"{count} GPUs"
