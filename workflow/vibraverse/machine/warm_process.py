"""A warm process that jobs are forked from, so that they find every library imported.

A job of a small object computes for a fraction of a second, and Python takes a second or more to start and import
what it computes with. A run of many jobs starts a process that imports everything once and listens, in each image that
its jobs run in. A stage's command that finds its address in ``VIBRAVERSE_WARM`` hands it what it was asked, with its
own input, output and environment, and waits. The job is the same: the log, the limits, the products. Where nothing
listens, or the command comes from another installation or wants more threads, it works by itself.

The warm process forks a job for each command. It tells the command the job's exit status, and kills the job when the
command is gone. It ends with the run that started it, however that ends; jobs that still work then go on to their end.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import secrets
import select
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping
from functools import partial

from vibraverse.contract.limits import die_with, threads
from vibraverse.flow.steps import STEPS
from vibraverse.machine import containers, warm
from vibraverse.machine.compiled import use_compiled_loops
from vibraverse.machine.threads import ROUNDING, set_threads

#: Fewer jobs than this take less than the warm process's own imports.
WORTHWHILE = 10
_GONE = select.POLLHUP | select.POLLERR | select.POLLRDHUP


def keep_warm(jobs: Mapping[str, int], apptainer_args: str = "") -> None:
    """Start a warm process for the jobs that this process is going to start, where they are many.

    ``jobs`` counts them by the image that they run in, "" for those that run in none; there is a process for each.
    ``apptainer_args`` are the run's own, so that the process sees what its jobs would see. A process listens as soon as
    it has imported; commands that come earlier work by themselves.
    """
    images = [image for image, count in jobs.items() if count >= WORTHWHILE]
    if not images or warm.VARIABLE in os.environ:
        return
    address = f"vibraverse-{os.getpid()}-{secrets.token_hex(8)}"
    # Nobody holds the pipe's writing end any more when this process has ended, so that the others read its end.
    reading, _held = os.pipe()
    for image in images:
        # -P: what lies in the working folder is no module.
        command = ["-P", "-m", "vibraverse", warm.SUBCOMMAND, address]
        subprocess.Popen(
            [sys.executable, *command]
            if not image
            else [*_in_image(image, apptainer_args), "python", *command],
            stdin=reading,
            # Who reads what the run says until its end need not wait for this process's.
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    os.close(reading)
    os.environ[warm.VARIABLE] = address


def _in_image(image: str, arguments: str) -> list[str]:
    """Return the beginning of a command that runs in an image as Snakemake runs its jobs."""
    return [containers.binary(), "exec", "--home", os.getcwd(), *shlex.split(arguments), image]


def serve(main: Callable[[list[str]], int], address: str) -> None:
    """Import, then fork jobs until the pipe that is the input has no writer any more; ``main`` is the command line."""
    run_ends = os.dup(sys.stdin.fileno())
    use_compiled_loops()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run, which tells by ending
    for step in preparation():
        if select.select([run_ends], [], [], 0)[0]:
            return
        with contextlib.suppress(Exception):  # a job that needs it will say what is wrong with it
            step()
    if threads() > 1:  # a fork might wait for ever for one that it does not have
        return
    gc.collect()
    gc.freeze()  # or a job's first collection writes into every object, and the kernel copies each one's page
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(warm.socket_name(address))
        listening.listen(64)
        Server(main, listening, run_ends).serve()


def preparation() -> list[Callable[[], object]]:
    """Return what is done before any job: import what stages need, and let libraries do what they first do."""
    set_threads(1)
    stages = [f"vibraverse.stages.{step.name}" for step in STEPS]
    imported = dict.fromkeys(name for step in STEPS for name in step.imports)
    imports = [partial(importlib.import_module, name) for name in (*stages, *imported)]
    return [*imports, *(partial(_prepare, name) for name in stages)]


def _prepare(stage: str) -> None:
    """Let a stage's libraries do what they first do."""
    getattr(sys.modules[stage], "prepare", lambda: None)()


class Server:
    """Forks a job for every command that connects, until ``run_ends`` tells that the run is over and no job is left."""

    def __init__(self, main: Callable[[list[str]], int], listening: socket.socket, run_ends: int):
        self._main = main
        self._listening, self._run_ends = listening, run_ends
        self._identity = warm.identity()
        self._poll = select.poll()
        self._poll.register(listening, select.POLLIN)
        self._poll.register(run_ends, _GONE)
        self._connections: dict[
            int, tuple[socket.socket, int, int]
        ] = {}  # and the job's number and descriptor
        self._jobs: dict[int, int] = {}  # a job's descriptor -> that of its connection

    def serve(self) -> None:
        """Work until the run is over."""
        open_ = True
        while open_ or self._jobs:
            for descriptor, _ in self._poll.poll():
                if descriptor == self._run_ends:
                    open_ = False
                    self._poll.unregister(self._run_ends)
                    self._poll.unregister(self._listening)
                    # A job that was just forked may hold it, too. Commands that wait there work by themselves.
                    self._listening.shutdown(socket.SHUT_RDWR)
                    self._listening.close()
                elif descriptor in self._jobs:
                    self._end(descriptor)
                elif descriptor in self._connections:  # the command is gone
                    self._poll.unregister(descriptor)
                    os.kill(self._connections[descriptor][1], signal.SIGKILL)
                elif open_ and descriptor == self._listening.fileno():
                    self._begin()  # any other is that of a command that went together with its job, a moment ago

    def _begin(self) -> None:
        """Fork the job of the next command."""
        connection, _ = self._listening.accept()
        if not warm.ours(connection):
            connection.close()
            return
        server = os.getpid()
        try:
            job = os.fork()
        except OSError:  # no memory, or too many processes: the command works by itself, or fails by itself
            self._answer(connection, warm.DECLINED)
            return
        if job == 0:
            status = 1
            try:
                die_with(server)
                self._close()
                status = _work(self._main, connection, self._identity)
            finally:
                os._exit(status)
        watched = os.pidfd_open(job)
        self._connections[connection.fileno()] = connection, job, watched
        self._jobs[watched] = connection.fileno()
        self._poll.register(connection, _GONE)
        self._poll.register(watched, select.POLLIN)

    def _end(self, watched: int) -> None:
        """Tell the command how its job ended."""
        descriptor = self._jobs.pop(watched)
        connection, job, _ = self._connections.pop(descriptor)
        self._poll.unregister(watched)
        with contextlib.suppress(KeyError):  # the command is gone
            self._poll.unregister(descriptor)
        os.close(watched)
        code = os.waitstatus_to_exitcode(os.waitpid(job, 0)[1])
        self._answer(connection, code if code >= 0 else 128 - code)

    @staticmethod
    def _answer(connection: socket.socket, status: int) -> None:
        with connection, contextlib.suppress(OSError):
            connection.sendall(str(status).encode())

    def _close(self) -> None:
        """Close, in a job, what is the server's: a command waits until nobody holds its connection."""
        self._listening.close()
        os.close(self._run_ends)
        for connection, _, watched in self._connections.values():
            connection.close()
            os.close(watched)


def _work(main: Callable[[list[str]], int], connection: socket.socket, identity: list[str]) -> int:
    """Do a command as its own process would; return its exit status."""
    with connection:
        head, files, _, _ = socket.recv_fds(connection, warm.LENGTH.size, 3)
        message = connection.makefile("rb").read(warm.LENGTH.unpack(head)[0])
    try:
        theirs, folder, mask, argv, environment = warm.understood(message)
    except ValueError:
        return warm.DECLINED
    rounding = {name: environment.get(name, os.environ.get(name)) for name in ROUNDING}
    if theirs != identity or rounding != {name: os.environ.get(name) for name in ROUNDING}:
        return warm.DECLINED
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace")
    os.chdir(folder)
    os.umask(mask)
    os.environ.clear()
    os.environ.update(environment)
    os.environ.pop(warm.VARIABLE, None)
    tempfile.tempdir = None  # to be looked up in this environment
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        status = main(argv)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    return status
