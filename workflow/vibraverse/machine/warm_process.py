"""The warm process: jobs are forked from it, so they find every library imported.

A job of a small object computes for a fraction of a second, but Python takes a second or more to start and import its
libraries. A run of many jobs starts a process that imports everything once and listens, one in each image of its jobs.
A stage's command that finds the address in ``VIBRAVERSE_WARM`` sends its arguments, files and environment, and waits.
The job is the same: its log, its limits, its products. A command runs by itself if nothing listens, if it comes from
another installation, or if it wants more threads.

In an image the warm process runs whole commands, too: starting a container takes longer than many a job. A program in
``entrance/`` stands before Apptainer on the PATH of the run, hands such commands over, and starts Apptainer otherwise.

The warm process forks a job for each command. It returns the job's exit status to the command, and kills the job when
the command is gone. It ends with the run that started it, however that ends; jobs that still work then finish.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
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
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from vibraverse.contract.limits import die_with, threads
from vibraverse.flow.steps import STEPS
from vibraverse.machine import containers, warm
from vibraverse.machine.compiled import use_compiled_loops
from vibraverse.machine.threads import ROUNDING, set_threads

#: Fewest jobs for which a warm process saves more time than its imports take.
MIN_JOBS = 10
#: Variable of a warm process in an image: checksums of the variables outside, by name. Others are the image's own.
_OUTSIDE = "VIBRAVERSE_OUTSIDE"
#: Signals that ask a process to end.
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2)
_HANGUP = select.POLLHUP | select.POLLERR | select.POLLRDHUP


def keep_warm(jobs: Mapping[str, int], apptainer_args: str = "") -> None:
    """Start a warm process for the jobs that this process is going to start, if they are many.

    ``jobs`` counts them by image, "" for those outside an image; each image gets a process of its own.
    ``apptainer_args`` are the run's own, so that the process sees the same files as its jobs. A process listens after
    its imports; commands that come earlier run by themselves.
    """
    images = [image for image, count in jobs.items() if count >= MIN_JOBS]
    if not images or warm.VARIABLE in os.environ:
        return
    address = f"vibraverse-{os.getpid()}-{secrets.token_hex(8)}"
    # The end of this process closes the writing end of the pipe, and so tells the warm processes that the run is over.
    reading, _held = os.pipe()
    outside = json.dumps({name: _checksum(value) for name, value in os.environ.items()})
    for image in images:
        # -P: Python must not import modules from the working folder.
        command = ["-P", "-m", "vibraverse", warm.SUBCOMMAND, address]
        subprocess.Popen(
            [sys.executable, *command]
            if not image
            else [*_in_image(image, apptainer_args), "python", *command],
            stdin=reading,
            env={**os.environ, _OUTSIDE: outside} if image else None,
            # A reader of the run's output must not have to wait for this process to end.
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    os.close(reading)
    os.environ[warm.VARIABLE] = address
    if any(images):
        _open_entrances([image for image in images if image], apptainer_args)


def _open_entrances(images: Sequence[str], apptainer_args: str) -> None:
    """Let this process's ``apptainer`` commands run in the warm processes of their images."""
    os.environ[warm.ENTRANCES] = "\n".join(
        "\t".join(_in_image(image, apptainer_args)[1:]) for image in images
    )
    os.environ["PATH"] = f"{Path(__file__).parent / 'entrance'}{os.pathsep}{os.environ['PATH']}"


def _in_image(image: str, arguments: str) -> list[str]:
    """Return the beginning of a command that runs in an image as Snakemake runs its jobs."""
    return [containers.binary(), "exec", "--home", os.getcwd(), *shlex.split(arguments), image]


def serve(main: Callable[[list[str]], int], address: str) -> None:
    """Import, then fork jobs until the pipe on standard input has no writer; ``main`` is the command line."""
    run_ends = os.dup(sys.stdin.fileno())
    own = _own_variables()
    use_compiled_loops()
    # Ctrl-C or a scheduler ends the run, and its end ends this process. Jobs may need longer.
    for number in _ENDING:
        signal.signal(number, signal.SIG_IGN)
    for step in preparation():
        if select.select([run_ends], [], [], 0)[0]:
            return
        with contextlib.suppress(Exception):  # a job that needs the module reports its error
            step()
    if threads() > 1:  # a fork lacks the other threads and might wait for them for ever
        return
    gc.collect()
    gc.freeze()  # otherwise a job's first collection writes to every object, and the kernel copies each page
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(warm.socket_name(address, warm.container()))
        listening.listen(64)
        Server(main, listening, run_ends, own).serve()


def _own_variables() -> dict[str, str]:
    """Return the variables that the image of this process has set; none outside an image."""
    outside = json.loads(os.environ.pop(_OUTSIDE, "null"))
    if outside is None:
        return {}
    return {name: value for name, value in os.environ.items() if outside.get(name) != _checksum(value)}


def _checksum(value: str) -> int:
    return zlib.crc32(os.fsencode(value))


def preparation() -> list[Callable[[], object]]:
    """Return the steps before the first job: import the modules of all stages, then initialise their libraries."""
    set_threads(1)
    stages = [f"vibraverse.stages.{step.name}" for step in STEPS]
    imported = dict.fromkeys(name for step in STEPS for name in step.imports)
    own = "vibraverse.flow.paths"  # which the command line imports itself
    imports = [partial(importlib.import_module, name) for name in (own, *stages, *imported)]
    return [*imports, *(partial(_prepare, name) for name in stages)]


def _prepare(stage: str) -> None:
    """Initialise a stage's libraries."""
    getattr(sys.modules[stage], "prepare", lambda: None)()


class Server:
    """The server that forks a job for every command, until ``run_ends`` hangs up and no job is left.

    ``own`` are the variables that its image sets.
    """

    def __init__(
        self,
        main: Callable[[list[str]], int],
        listening: socket.socket,
        run_ends: int,
        own: Mapping[str, str],
    ):
        self._main, self._own = main, own
        self._listening, self._run_ends = listening, run_ends
        self._identity = warm.identity()
        self._poll = select.poll()
        self._poll.register(listening, select.POLLIN)
        self._poll.register(run_ends, _HANGUP)
        #: Descriptor of a connection -> the connection, its job's process number and pidfd.
        self._connections: dict[int, tuple[socket.socket, int, int]] = {}
        #: Pidfd of a job -> descriptor of its connection.
        self._jobs: dict[int, int] = {}

    def serve(self) -> None:
        """Serve commands until the run is over."""
        open_ = True
        while open_ or self._jobs:
            for descriptor, _ in self._poll.poll():
                if descriptor == self._run_ends:
                    open_ = False
                    self._poll.unregister(self._run_ends)
                    self._poll.unregister(self._listening)
                    # A job that was just forked may hold the socket too. Commands that wait there run by themselves.
                    self._listening.shutdown(socket.SHUT_RDWR)
                    self._listening.close()
                elif descriptor in self._jobs:
                    self._end(descriptor)
                elif descriptor in self._connections:  # the command is gone
                    self._poll.unregister(descriptor)
                    _kill(self._connections[descriptor][1])
                elif open_ and descriptor == self._listening.fileno():
                    self._begin()  # any other descriptor belongs to a command and job that have both just ended

    def _begin(self) -> None:
        """Fork the job of the next command."""
        connection, _ = self._listening.accept()
        if not warm.ours(connection):
            connection.close()
            return
        server = os.getpid()
        try:
            job = os.fork()
        except OSError:  # no memory, or too many processes: the command runs or fails by itself
            self._answer(connection, warm.DECLINED)
            return
        if job == 0:
            status = 1
            try:
                die_with(server)
                self._close()
                status = _work(self._main, connection, self._identity, self._own)
            finally:
                os._exit(status)
        watched = os.pidfd_open(job)
        self._connections[connection.fileno()] = connection, job, watched
        self._jobs[watched] = connection.fileno()
        self._poll.register(connection, _HANGUP)
        self._poll.register(watched, select.POLLIN)

    def _end(self, watched: int) -> None:
        """Return the job's exit status to its command."""
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
        """Close the server's descriptors in a job: a command waits until no process holds its connection."""
        self._listening.close()
        os.close(self._run_ends)
        for connection, _, watched in self._connections.values():
            connection.close()
            os.close(watched)


def _kill(job: int) -> None:
    """Kill a job, and with it all of its group if it leads one."""
    try:
        os.killpg(job, signal.SIGKILL)
    except ProcessLookupError:
        os.kill(job, signal.SIGKILL)


def _work(
    main: Callable[[list[str]], int],
    connection: socket.socket,
    identity: list[str],
    own: Mapping[str, str],
) -> int:
    """Run a command as its own process would; return its exit status."""
    with connection:
        head, files, _, _ = socket.recv_fds(connection, warm.LENGTH.size, 3)
        message = connection.makefile("rb").read(warm.LENGTH.unpack(head)[0])
        try:
            theirs, folder, mask, argv, environment = warm.parse(message)
        except ValueError:
            return warm.DECLINED
        entering = theirs == warm.visitor(warm.container())
        if entering:
            os.setpgid(0, 0)  # what the command starts ends with it
            connection.sendall(f"{os.getpid()}\n".encode())
        elif theirs != identity or any(
            environment.get(name, os.environ.get(name)) != os.environ.get(name) for name in ROUNDING
        ):
            return warm.DECLINED
    _take_over(files, folder, mask)
    for number in _ENDING:
        signal.signal(number, signal.SIG_DFL)
    if entering:
        os.execvpe(argv[0], argv, {**environment, **own})
    sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace")
    os.environ.clear()
    os.environ.update(environment)
    os.environ.pop(warm.VARIABLE, None)
    tempfile.tempdir = None  # tempfile must look it up again in the command's environment
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


def _take_over(files: Sequence[int], folder: str, mask: int) -> None:
    """Take a command's standard files, its working folder and its umask."""
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.chdir(folder)
    os.umask(mask)
