"""Limits of time and memory for one function in a child process, or of memory for this process.

Meshers hang and crash on real models. In a child process they cost one object, not the run: a timeout, a crash or an
exhausted memory limit becomes a refusal that quotes the tool's last words. Solvers neither hang nor crash, but their
memory grows fast with the mesh; they get a limit in the process where they run.

The child is a fork, because it then has the libraries that its parent imported. Importing them again takes longer than
many a body. A fork of a process with several threads may deadlock, because it lacks the other threads; such a process
starts a new one instead.

The time limit counts work: a busy machine, or one that suspends its jobs, refuses the same objects as an idle one.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from vibraverse.contract.errors import PROGRAMMING, ChildFailed, Refused
from vibraverse.contract.progress import report, reports_to

#: Bytes at the end of a child's log that are searched for its last words.
_LOG_TAIL_BYTES = 600
#: Messages of libraries that ran out of memory: the loader, C, C++, SuperLU, OpenBLAS.
_OUT_OF_MEMORY = (
    "failed to map segment",
    "Cannot allocate memory",
    "bad_alloc",
    "MALLOC fails",
    "alloc() fails",
    "Memory allocation still failed",
)
#: Types of the exceptions that carry these messages.
_OUT_OF_MEMORY_TYPES = (ImportError, MemoryError, OSError, RuntimeError)
_PR_SET_PDEATHSIG = 1


def die_with(parent: int) -> None:
    """Let the kernel kill this process when its ``parent`` ends, however the parent ends.

    A child that outlives a killed job computes in vain, and then waits for ever to send its result.
    """
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # the parent ended before the call
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
        with reports_to(lambda sentence: connection.send(("report", sentence))):
            value = function(*arguments)
        connection.send(("ok", value))
    except Refused as refused:
        connection.send(("refused", refused))
    except Exception as error:  # the outermost frame of this process: the parent reports every error
        if out_of_memory(error):
            connection.send(("memory", None))
        elif isinstance(error, PROGRAMMING):
            connection.send(("mistake", traceback.format_exc()))
        else:
            connection.send(("error", f"{type(error).__name__}: {error}"))
    connection.close()


def out_of_memory(error: Exception) -> bool:
    """Return whether an error means that memory ran out, whether Python or a library raised it."""
    return isinstance(error, MemoryError) or _tells_of_memory(str(error))


def _tells_of_memory(text: str) -> bool:
    return any(words in text for words in _OUT_OF_MEMORY)


def _limit(memory_mb: int) -> int:
    """Return the address-space limit in bytes that leaves this process ``memory_mb`` more, within its hard limit."""
    import resource

    limit, hard = memory_mb * 2**20 + _address_space(), resource.getrlimit(resource.RLIMIT_AS)[1]
    return limit if hard == resource.RLIM_INFINITY else min(limit, hard)


def _address_space() -> int:
    """Return the address space of this process in bytes, mostly libraries; 0 without ``/proc``."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def threads() -> int:
    """Return the number of threads of this process; 0 without ``/proc``."""
    try:
        return len(os.listdir("/proc/self/task"))
    except OSError:
        return 0


def run_limited(
    function: Callable, *arguments, seconds: float, memory_mb: int, what: str, key: str = "limits"
):
    """Return ``function(*arguments)``, computed in a child process with limits.

    ``function`` must be importable, its arguments and result picklable. ``what`` names the tool in the refusal
    ("gmsh"), ``key`` the section of the configuration that sets the limits. ``seconds`` limits the child's CPU time,
    and the time for which it may stand still. ``memory_mb`` limits the address space that it takes after its start.
    What the function reports (:func:`~vibraverse.contract.progress.report`) is reported here, too.

    Raises :class:`Refused` with reason ``limit`` after a timeout or a kill, or when memory runs out, with
    ``meshing_failed`` after a crash or an exception, and the :class:`Refused` that the function itself raises. Raises
    :class:`ChildFailed` after a programming error.
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
            status, value = _answer(receiver, process.pid, seconds)
        except (EOFError, OSError, pickle.UnpicklingError):  # no answer, or half of one
            status, value = "crash", None
        if status == "timeout":
            process.kill()
        process.join()
        words = Path(log).read_bytes()[-_LOG_TAIL_BYTES:].decode(errors="replace").strip()
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
    if status == "crash" and process.exitcode == -signal.SIGKILL:
        raise Refused(
            "limit",
            f"{what} was killed from outside, as the system does when the machine's memory runs out.{said}",
            "Run fewer jobs at once, or simplify the mesh.",
        )
    if status == "memory" or (status == "crash" and _tells_of_memory(words)):
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


def _answer(receiver, pid: int, seconds: float) -> tuple[str, object]:
    """Wait for a child's answer, passing its reports on; return its status and value.

    The status is ``"timeout"`` where the child exceeded a limit; the value then says which.
    """
    step, worked, still = min(1.0, seconds / 4), 0.0, 0.0
    while worked <= seconds and still <= seconds:
        began = time.monotonic()
        if receiver.poll(step):
            status, value = receiver.recv()
            if status != "report":
                return status, value
            report(value)
        before, worked = worked, _cpu_s(pid)
        # A much longer step means that this process was suspended, and the child with it.
        still = 0.0 if worked > before else still + min(time.monotonic() - began, 2 * step)
    over = (
        f"after {seconds:g} s of CPU time"
        if worked > seconds
        else f"when it had stood still for {seconds:g} s"
    )
    return "timeout", over


def _cpu_s(pid: int) -> float:
    """Return the CPU time of a process in seconds; 0 without ``/proc``."""
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii", errors="replace") as file:
            ticks = file.read().rpartition(")")[2].split()[11:13]
        return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return 0.0


@contextmanager
def limited_memory(memory_mb: int, what: str, key: str) -> Iterator[None]:
    """Limit this process to ``memory_mb`` of address space more than it has now; ``key`` configures the limit.

    Raises :class:`Refused` with reason ``limit`` instead of ``MemoryError``.
    """
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_limit(memory_mb), before[1]))
    try:
        yield
    except _OUT_OF_MEMORY_TYPES as error:
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
    """Let this process reuse the memory that it frees.

    Solvers allocate and free arrays of tens of megabytes hundreds of times. By default glibc returns each to the
    kernel, which clears the pages for the next one: a fifth of the time of an eigensolve. Does nothing without glibc.
    """
    import ctypes

    trim_threshold, top_pad, mmap_max = -1, -2, -4
    with suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in ((mmap_max, 0), (trim_threshold, 2**31 - 1), (top_pad, 2**26)):
            mallopt(parameter, value)
