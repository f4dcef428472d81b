"""A warm process that jobs are forked from, so that they find every library imported.

A job of a small object computes for a fraction of a second, and Python takes a second or more to start and import
what it computes with. :class:`Warm` starts one process that imports everything once and listens; a stage's command
that finds its address in ``VIBRAVERSE_WARM`` hands it what it was asked, with its own input, output and environment,
and waits. The job is the same: the log, the limits, the products. Where nothing listens, or the command comes
from another installation or wants more threads, it works by itself.

For each command the warm process forks a keeper, and that the job. The keeper tells the command the job's exit
status, and kills the job when the command is gone.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import select
import shutil
import signal
import socket
import struct
import sys
import tempfile
import traceback

from vibraverse.cli import ROUNDING, asked_threads, main, set_threads
from vibraverse.limits import die_with

VARIABLE = "VIBRAVERSE_WARM"
#: What jobs import. Names that the environment lacks are passed over.
_LIBRARIES = (
    "vibraverse.config", "vibraverse.meshfiles", "vibraverse.sources.families", "vibraverse.geometry.clean",
    "vibraverse.geometry.grids", "vibraverse.geometry.distance", "vibraverse.geometry.hollow",
    "vibraverse.geometry.tets", "vibraverse.physics.basis", "vibraverse.physics.modes", "vibraverse.physics.impulse",
    "vibraverse.media.audio", "vibraverse.media.images", "vibraverse.dataset.pack", "gmsh", "h5py", "manifold3d",
    "meshio", "mmgpy", "open3d", "pymeshlab", "pypardiso", "pyvista", "skfem", "soundfile",
)  # fmt: skip
_LENGTH = struct.Struct("!I")
_DECLINED = "declined"


def _identity() -> list[str]:
    """Return what a command and the warm process must share: the interpreter and this file."""
    return [sys.executable, os.path.realpath(__file__)]


def ask(address: str, argv: list[str]) -> int | None:
    """Let the warm process do a command; return its exit status, or None where it must be done here."""
    if asked_threads(argv) != "1":
        return None
    mask = os.umask(0)
    os.umask(mask)
    asked = {"argv": argv, "folder": os.getcwd(), "mask": mask, "environment": dict(os.environ)}
    message = json.dumps({**asked, "identity": _identity()}).encode()
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            connection.connect(address)
            socket.send_fds(connection, [_LENGTH.pack(len(message))], [0, 1, 2])
            connection.sendall(message)
            answer = connection.makefile("r").read()
        except OSError:  # nothing listens there, or it ended before it took the command
            return None
    if answer == _DECLINED:
        return None
    if not answer:
        print("vibraverse: the warm process ended before the job did", file=sys.stderr)
        return 1
    return int(answer)


class Warm:
    """A context in which a warm process listens at ``address``."""

    def __enter__(self) -> Warm:
        """Start the process; it imports while the first commands wait."""
        self.folder = tempfile.mkdtemp(prefix="vibraverse-warm-")
        self.address = os.path.join(self.folder, "socket")
        listening = socket.socket(socket.AF_UNIX)
        listening.bind(self.address)
        listening.listen(64)
        sys.stdout.flush()
        sys.stderr.flush()
        parent = os.getpid()
        self.process = os.fork()
        if self.process == 0:
            try:
                die_with(parent)
                _serve(listening)
            finally:
                os._exit(1)
        listening.close()
        return self

    def __exit__(self, *_) -> None:
        """End the process; jobs that still run go on to their end."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process, signal.SIGKILL)
        os.waitpid(self.process, 0)
        shutil.rmtree(self.folder, ignore_errors=True)


def _serve(listening: socket.socket) -> None:
    """Import, then fork a keeper for every command, for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    set_threads(1)
    identity = _identity()
    for name in _LIBRARIES:
        with contextlib.suppress(Exception):  # a job that needs it will say what is wrong with it
            importlib.import_module(name)
    with contextlib.suppress(Exception):
        _load_compiled_loops()
    signal.signal(signal.SIGCHLD, _reap)
    while True:
        connection, _ = listening.accept()
        if os.fork() == 0:
            listening.close()
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            try:
                _keep(connection, identity)
            finally:
                os._exit(0)
        connection.close()


def _reap(*_) -> None:
    """Take note of the keepers that have ended, so that they leave no zombies and their time is counted."""
    with contextlib.suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _load_compiled_loops() -> None:
    """Use each loop on a tetrahedron: Numba loads it from its cache when it is first called."""
    import numpy as np

    from vibraverse.geometry.clean import clean
    from vibraverse.geometry.distance import grid_distance

    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    body = clean(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    grid_distance(body.vertices, body.faces, *[np.linspace(-0.9, 0.9, 8)] * 3)


def _keep(connection: socket.socket, identity: list[str]) -> None:
    """Run one command in a fork; tell its exit status, or kill it when nobody waits for it."""
    head, files, _, _ = socket.recv_fds(connection, _LENGTH.size, 3)
    message = connection.makefile("rb").read(_LENGTH.unpack(head)[0])
    asked = json.loads(message)
    rounding = {name: asked["environment"].get(name, os.environ.get(name)) for name in ROUNDING}
    if asked["identity"] != identity or rounding != {name: os.environ.get(name) for name in ROUNDING}:
        connection.sendall(_DECLINED.encode())
        return
    keeper = os.getpid()
    job = os.fork()
    if job == 0:
        die_with(keeper)
        connection.close()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        status = 1
        try:
            status = _work(asked, files)
        finally:
            os._exit(status)
    watched = os.pidfd_open(job)
    ready, _, _ = select.select([connection, watched], [], [])
    if watched not in ready:
        os.kill(job, signal.SIGKILL)
    _, status = os.waitpid(job, 0)
    code = os.waitstatus_to_exitcode(status)
    with contextlib.suppress(OSError):
        connection.sendall(str(code if code >= 0 else 128 - code).encode())


def _work(asked: dict, files: list[int]) -> int:
    """Do a command as its own process would; return its exit status."""
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    sys.stdin, sys.stdout = os.fdopen(0), os.fdopen(1, "w")
    sys.stderr = os.fdopen(2, "w", buffering=1, errors="backslashreplace")
    os.chdir(asked["folder"])
    os.umask(asked["mask"])
    os.environ.clear()
    os.environ.update(asked["environment"])
    os.environ.pop(VARIABLE, None)
    try:
        status = main(asked["argv"])
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    return status
