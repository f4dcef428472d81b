"""Limits of time and memory: of one function in a child process, or of memory in this one.

Meshers hang and crash on real models. In a child they cost one object, not the run: a timeout, a crash or
an exhausted memory limit becomes a refusal that carries the tool's last words. Solvers do neither, but what they need
grows fast with the mesh; they get a limit where they run.

The child is a fork: it has the libraries that its parent imported, which a new process would import again for longer
than many a body takes. A fork of a process with several threads may wait for ever for one that it does not have, so
there the child is a new process.

A limit of time is one of work: a busy machine, and one that suspends its jobs, refuse the same objects as an idle one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vibraverse.contract.errors import PROGRAMMING, ChildFailed, Refused

_TAIL = 600
#: What libraries say when there is no memory left: the loader, C, C++, SuperLU.
_OUT_OF_MEMORY = (
    "failed to map segment",
    "Cannot allocate memory",
    "bad_alloc",
    "MALLOC fails",
    "alloc() fails",
)
#: What they raise then.
_EXHAUSTED = (ImportError, MemoryError, OSError, RuntimeError)
_PR_SET_PDEATHSIG = 1


def die_with(parent: int) -> None:
    """Let this process be killed when its ``parent`` ends, however that ends.

    A child that outlives a killed job computes for nobody, and then waits for ever to tell its result.
    """
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before that
        os._exit(1)


def _child(parent: int, connection, log: str, memory_mb: int, function: Callable, arguments: tuple) -> None:
    import resource

    die_with(parent)
    with open(log, "wb", buffering=0) as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    limit = _limit(memory_mb)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        connection.send(("ok", function(*arguments)))
    except Refused as refused:
        connection.send(("refused", refused))
    except Exception as error:  # the edge of this process: whatever it is, the parent says it
        if out_of_memory(error):
            connection.send(("memory", None))
        elif isinstance(error, PROGRAMMING):
            connection.send(("mistake", traceback.format_exc()))
        else:
            connection.send(("error", f"{type(error).__name__}: {error}"))
    connection.close()


def out_of_memory(error: Exception) -> bool:
    """Return whether an error means that there is no memory left, in Python's words or a library's."""
    return isinstance(error, MemoryError) or any(words in str(error) for words in _OUT_OF_MEMORY)


def _limit(memory_mb: int) -> int:
    """Return the bytes of address space that this process may have to take so much more, and no more than it may."""
    import resource

    limit, hard = memory_mb * 2**20 + _address_space(), resource.getrlimit(resource.RLIMIT_AS)[1]
    return limit if hard == resource.RLIM_INFINITY else min(limit, hard)


def _address_space() -> int:
    """Return the bytes of address space that this process has, libraries mostly; 0 where the system does not say."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def threads() -> int:
    """Return how many threads this process has; 0 where the system does not say."""
    try:
        return len(os.listdir("/proc/self/task"))
    except OSError:
        return 0


def run_limited(
    function: Callable, *arguments, seconds: float, memory_mb: int, what: str, key: str = "limits"
):
    """Return ``function(*arguments)``, computed in a child process with limits.

    ``function`` must be importable and its arguments and result picklable; ``what`` names the tool in the
    refusal ("gmsh"), ``key`` the section of the configuration that the limits come from. ``seconds`` limits the CPU
    time that the child takes, and the time in which it takes none; ``memory_mb`` the address space besides what it
    starts with.

    Raises :class:`Refused` with reason ``limit`` at a timeout or when memory ran out, ``meshing_failed`` after a
    crash or an exception, or the :class:`Refused` that the function itself raised; :class:`ChildFailed` after a
    programming error.
    """
    context = multiprocessing.get_context("fork" if threads() == 1 else "spawn")
    receiver, sender = context.Pipe(duplex=False)
    handle, log = tempfile.mkstemp(prefix="vibraverse-", suffix=".log")
    os.close(handle)
    process = context.Process(
        target=_child, args=(os.getpid(), sender, log, memory_mb, function, arguments), daemon=True
    )
    try:
        process.start()
        sender.close()
        try:
            over = _overtime(receiver, process.pid, seconds)
            status, value = ("timeout", over) if over else receiver.recv()
        except EOFError:
            status, value = "crash", None
        if status == "timeout":
            process.kill()
        process.join()
        words = Path(log).read_bytes()[-_TAIL:].decode(errors="replace").strip()
    finally:
        if process.is_alive():
            process.kill()
            process.join()
        receiver.close()
        Path(log).unlink(missing_ok=True)
    if status == "ok":
        return value
    if status == "refused":
        raise value
    if status == "mistake":
        raise ChildFailed(f"a programming error in the process of {what}:\n{value}")
    print(f"{what}: {status}; last words: {words}", file=sys.stderr)
    said = f" Its last words: {words.splitlines()[-1].rstrip('.')}." if words else ""
    if status == "timeout":
        raise Refused(
            "limit",
            f"{what} was stopped {value}.{said}",
            f"Raise {key}.seconds, or simplify the mesh.",
        )
    if status == "memory" or process.exitcode == -signal.SIGKILL:
        raise Refused(
            "limit",
            f"{what} needed more than {memory_mb} MB.{said}",
            f"Raise {key}.memory_mb, or simplify the mesh.",
        )
    if status == "crash":
        number = -(process.exitcode or 0)
        name = signal.Signals(number).name if number > 0 else f"exit status {process.exitcode}"
        raise Refused(
            "meshing_failed",
            f"{what} crashed ({name}).{said}",
            f"Repair or simplify the mesh, or raise {key}.memory_mb: some tools crash where memory ends.",
        )
    raise Refused("meshing_failed", f"{what} failed: {value}.{said}", "Repair or simplify the mesh.")


def _overtime(receiver, pid: int, seconds: float) -> str:
    """Wait for a child's answer; return nothing, or what the child did for longer than it may."""
    step, worked, still = min(1.0, seconds / 4), 0.0, 0.0
    while worked <= seconds and still <= seconds:
        began = time.monotonic()
        if receiver.poll(step):
            return ""
        before, worked = worked, _cpu_s(pid)
        # A step that took much longer is one in which this process was stopped, and the child with it.
        still = 0.0 if worked > before else still + min(time.monotonic() - began, 2 * step)
    return (
        f"after {seconds:g} s of CPU time"
        if worked > seconds
        else f"when it had stood still for {seconds:g} s"
    )


def _cpu_s(pid: int) -> float:
    """Return the CPU seconds that a process has taken; 0 where the system does not say."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
            ticks = file.read().rpartition(")")[2].split()[11:13]
        return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return 0.0


@contextmanager
def limited_memory(memory_mb: int, what: str, key: str) -> Iterator[None]:
    """Let this process have no more than ``memory_mb`` of address space besides what it has, as configured by ``key``.

    Raises :class:`Refused` with reason ``limit`` instead of ``MemoryError``.
    """
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_limit(memory_mb), before[1]))
    try:
        yield
    except _EXHAUSTED as error:
        if not out_of_memory(error):
            raise
        raise Refused(
            "limit",
            f"{what} needed more than {memory_mb} MB.",
            f"Raise {key}, or lower tets.target_elements.",
        ) from None
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def keep_memory() -> None:
    """Let this process keep the memory it frees for what it needs next.

    Solvers take and free arrays of tens of megabytes hundreds of times. By default glibc hands each back to the kernel,
    which clears it for the next one: a fifth of an eigensolve. Where there is no glibc, nothing happens.
    """
    import ctypes

    trim_threshold, top_pad, mmap_max = -1, -2, -4
    with suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in ((mmap_max, 0), (trim_threshold, 2**31 - 1), (top_pad, 2**26)):
            mallopt(parameter, value)
