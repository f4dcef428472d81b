"""The clients of a warm process: commands that hand their work over; ``warm_process`` is the server.

A stage's command is one, and what stands before Apptainer on the PATH (``entrance``) the other. There are ten of each
for an object, so this module imports as little as possible.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import zlib

#: Environment variable with the address of a warm process; if it is set, even to "", none is started. The address is a
#: name in Linux's abstract socket namespace, which leaves no file behind.
VARIABLE = "VIBRAVERSE_WARM"
#: Environment variable with the beginnings of the commands whose image has a warm process: words of ``apptainer``
#: separated by ``\t``, each such list on a line. The last word is the image.
ENTRANCES = "VIBRAVERSE_ENTRANCES"
#: Subcommand of ``python -m vibraverse`` that starts a warm process; not for people.
SUBCOMMAND = "warm-process"
#: Prefix of a message: its length in bytes.
LENGTH = struct.Struct("!I")
#: ``struct ucred``, the credentials of the process at the other end: process, user, group.
_CREDENTIALS = struct.Struct("3i")
#: What stands for the installation in a request to run any command in the image of the warm process.
ENTER = "enter"
#: Stages that save what they have when a scheduler tells them to end, so that its signals must reach them.
_SIGNALLED = ("train",)
#: Exit status by which a warm process declines a command; no stage ends with it.
DECLINED = 79


def container() -> str:
    """Return the image that this process runs in; "" outside an image."""
    return os.environ.get("APPTAINER_CONTAINER") or os.environ.get("SINGULARITY_CONTAINER") or ""


def identity() -> list[str]:
    """Return what a command and its warm process must share: the Python environment, this file, the image."""
    return [sys.prefix, os.path.realpath(__file__), container()]


def visitor(image: str) -> list[str]:
    """Return what :func:`identity` does for any command that is to run in an image, and sees the same processes."""
    return [ENTER, os.readlink("/proc/self/ns/pid"), image]


def socket_name(address: str, image: str) -> str:
    """Return the abstract socket name of a warm process; there is one per image of a run, "" for that outside."""
    return f"\0{address}-{zlib.crc32(os.fsencode(image)):08x}" if image else f"\0{address}"


def ours(connection: socket.socket) -> bool:
    """Return whether the other end of a connection is this user's: anybody may use an abstract socket name."""
    found = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return _CREDENTIALS.unpack(found)[1] == os.getuid()


def ask(address: str, argv: list[str]) -> int | None:
    """Let the warm process at an address run a command; return its exit status, or None if it must run here."""
    from vibraverse.machine.threads import asked_threads

    if argv[0] in _SIGNALLED or asked_threads(argv) != "1":
        return None
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            if not _sent(connection, socket_name(address, container()), request(identity(), argv)):
                return None
            answer = connection.makefile("r").read()
        except OSError:  # nothing listens there, or it ended before it took the command
            return None
    if not answer:
        print("vibraverse: the warm process ended before the job did", file=sys.stderr)
        return 1
    return None if int(answer) == DECLINED else int(answer)


def enter(argv: list[str]) -> int | None:
    """Let the warm process of an image run what ``apptainer`` is asked to, ``argv``; return as :func:`ask` does.

    Starting a container takes longer than many a job. The warm process is in the same one, so it runs the command, and
    what this process is told by signals is passed on.
    """
    address, words = os.environ.get(VARIABLE), "\t".join(argv) + "\t"
    begun = next(
        (one for one in os.environ.get(ENTRANCES, "").splitlines() if words.startswith(f"{one}\t")), ""
    )
    if not address or not begun:
        return None
    beginning = begun.split("\t")
    image = os.path.realpath(beginning[-1])
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            message = request(visitor(image), argv[len(beginning) :])
            if not _sent(connection, socket_name(address, image), message):
                return None
            answers = connection.makefile("r")
            process = answers.readline()
        except OSError:
            return None
        if not process.endswith("\n"):
            return None  # declined
        _pass_on_signals(int(process))
        status = answers.read()
    return int(status) if status else 1


def _pass_on_signals(group: int) -> None:
    """Send every signal that asks this process to end to a group of processes instead."""
    import contextlib
    import signal

    def pass_on(number: int, frame) -> None:
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.killpg(group, number)

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2):
        signal.signal(number, pass_on)


def _sent(connection: socket.socket, name: str, message: bytes) -> bool:
    """Send a message and the standard files to the process at a name; return whether it is this user's."""
    connection.connect(name)
    if not ours(connection):
        return False
    socket.send_fds(connection, [LENGTH.pack(len(message))], [0, 1, 2])
    connection.sendall(message)
    return True


def request(identity: list[str], argv: list[str]) -> bytes:
    """Return a command as a message: everything that its own process would have, except open files."""
    mask = os.umask(0)
    os.umask(mask)
    variables = [f"{name}={value}" for name, value in os.environ.items()]
    return os.fsencode("\0".join([*identity, os.getcwd(), str(mask), str(len(argv)), *argv, *variables]))


def parse(message: bytes) -> tuple[list[str], str, int, list[str], dict[str, str]]:
    """Return identity, working folder, umask, arguments and environment from a :func:`request`."""
    prefix, file, image, folder, mask, count, *words = os.fsdecode(message).split("\0")
    argv, variables = words[: int(count)], words[int(count) :]
    return [prefix, file, image], folder, int(mask), argv, dict(one.split("=", 1) for one in variables)
