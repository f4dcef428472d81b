"""Functions in child processes: their limits, and the messages about their ends."""

from __future__ import annotations

import gc
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

from vibraverse.contract.errors import ChildFailed, Refused
from vibraverse.contract.limits import run_limited


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def kill() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def half() -> None:
    """Send half of an answer and end, as a child does that is killed while it answers."""
    sender = next(
        one for one in gc.get_objects() if isinstance(one, Connection) and not one.closed and one.writable
    )
    os.write(sender.fileno(), struct.pack("!i", 1_000) + b"half")
    os._exit(3)


def unloaded() -> None:
    raise ImportError("libwide.so: failed to map segment from shared object")


def large() -> bytes:
    """Return a result that takes as much memory again to send."""
    return bytes(200 * 10**6)


def spin(seconds: float) -> str:
    """Compute for this much CPU time in seconds."""
    while time.process_time() < seconds:
        pass
    return "done"


def process() -> int:
    return os.getppid()


@pytest.fixture(params=["one thread", "two threads"])
def threads(request):
    """With a second thread the child is a new process, not a fork."""
    done = threading.Event()
    if request.param == "two threads":
        threading.Thread(target=done.wait).start()
    yield request.param
    done.set()


def test_a_result_comes_back_from_a_child(threads):
    assert run_limited(process, seconds=60, memory_mb=500, what="it") == os.getpid()


@pytest.mark.parametrize(
    ("function", "arguments", "seconds", "reason", "words"),
    [
        (np.ones, (10**8,), 60, "limit", "it needed more than 300 MB."),
        (unloaded, (), 60, "limit", "it needed more than 300 MB."),
        (large, (), 60, "limit", "it needed more than 300 MB."),
        (time.sleep, (60,), 3, "limit", "it was stopped when it had stood still for 3 s."),
        (spin, (60,), 0.5, "limit", "it was stopped after 0.5 s of CPU time."),
        (crash, (), 60, "meshing_failed", "it crashed (SIGSEGV)."),
        (half, (), 60, "meshing_failed", "it crashed (exit status 3)."),
        (
            kill,
            (),
            60,
            "limit",
            "it was killed from outside, as the system does when the machine's memory runs out.",
        ),
        (int, ("x",), 60, "meshing_failed", "it failed: ValueError"),
    ],
)
def test_how_a_child_ends_is_said(threads, function, arguments, seconds, reason, words):
    with pytest.raises(Refused, match=words.replace("(", r"\(").replace(")", r"\)")) as refused:
        run_limited(function, *arguments, seconds=seconds, memory_mb=300, what="it")
    assert refused.value.reason == reason


def mistaken() -> None:
    None.gone  # noqa: B018


@pytest.mark.parametrize(
    ("function", "arguments", "words"),
    [(mistaken, (), "'NoneType' object has no attribute 'gone'"), (spin, ("1",), "TypeError")],
)
def test_a_mistake_of_ours_in_a_child_is_no_refusal(threads, function, arguments, words):
    with pytest.raises(ChildFailed, match=words) as failed:
        run_limited(function, *arguments, seconds=60, memory_mb=300, what="it")
    assert "Traceback" in str(failed.value)
    assert "test_limits.py" in str(failed.value)


def test_memory_is_counted_from_what_the_process_has(threads):
    assert run_limited(np.ones, 5 * 10**6, seconds=60, memory_mb=200, what="it").sum() == 5 * 10**6


def test_a_job_that_is_suspended_is_not_refused_for_it():
    program = (
        "from test_limits import spin\n"
        "from vibraverse.contract.limits import run_limited\n"
        "print(run_limited(spin, 1.0, seconds=3, memory_mb=500, what='it'))\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program],
        cwd=Path(__file__).parent,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as job:
        children = Path(f"/proc/{job.pid}/task/{job.pid}/children")
        while not children.read_text():
            assert job.poll() is None
            time.sleep(0.02)
        os.killpg(job.pid, signal.SIGSTOP)
        time.sleep(6)
        os.killpg(job.pid, signal.SIGCONT)
        assert job.communicate(timeout=60)[0] == "done\n"


def wide(seconds: float) -> bytes:
    """Return more than a pipe holds, after a while."""
    time.sleep(seconds)
    return bytes(10**6)


def test_a_child_ends_with_its_process(tmp_path):
    """A killed job leaves no child that computes or waits for ever to send its result."""
    program = (
        "from test_limits import wide\n"
        "from vibraverse.contract.limits import run_limited\n"
        "run_limited(wide, 1.0, seconds=60, memory_mb=500, what='it')\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], cwd=Path(__file__).parent) as job:
        children = Path(f"/proc/{job.pid}/task/{job.pid}/children")
        while not (child := children.read_text().split()):
            assert job.poll() is None
            time.sleep(0.02)
        time.sleep(0.3)
        job.kill()
    time.sleep(0.2)
    status = Path(f"/proc/{child[0]}/status")
    assert (
        not status.exists() or "State:\tZ" in status.read_text()
    )  # who takes over the orphan may not reap it
