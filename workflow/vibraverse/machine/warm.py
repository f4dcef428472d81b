"""The client of a warm process: a stage's command hands its work over; ``warm_process`` is the server.

There are ten such commands for each object, so this module imports as little as possible.
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
#: Subcommand of ``python -m vibraverse`` that starts a warm process; not for people.
SUBCOMMAND = "warm-process"
#: Prefix of a message: its length in bytes.
LENGTH = struct.Struct("!I")
#: ``struct ucred``, the credentials of the process at the other end: process, user, group.
_CREDENTIALS = struct.Struct("3i")
#: Exit status by which a warm process declines a command; no stage ends with it.
DECLINED = 79


def container() -> str:
    """Return the image that this process runs in; "" outside an image."""
    return os.environ.get("APPTAINER_CONTAINER") or os.environ.get("SINGULARITY_CONTAINER") or ""


def identity() -> list[str]:
    """Return what a command and its warm process must share: the Python environment, this file, the image."""
    return [sys.prefix, os.path.realpath(__file__), container()]


def socket_name(address: str) -> str:
    """Return the abstract socket name of a warm process; there is one per image of a run."""
    image = container()
    return f"\0{address}-{zlib.crc32(os.fsencode(image)):08x}" if image else f"\0{address}"


def ours(connection: socket.socket) -> bool:
    """Return whether the other end of a connection is this user's: anybody may use an abstract socket name."""
    found = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return _CREDENTIALS.unpack(found)[1] == os.getuid()


def ask(address: str, argv: list[str]) -> int | None:
    """Let the warm process at an address run a command; return its exit status, or None if it must run here."""
    from vibraverse.machine.threads import asked_threads

    if asked_threads(argv) != "1":
        return None
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            connection.connect(socket_name(address))
            if not ours(connection):
                return None
            message = request(argv)
            socket.send_fds(connection, [LENGTH.pack(len(message))], [0, 1, 2])
            connection.sendall(message)
            answer = connection.makefile("r").read()
        except OSError:  # nothing listens there, or it ended before it took the command
            return None
    if not answer:
        print("vibraverse: the warm process ended before the job did", file=sys.stderr)
        return 1
    return None if int(answer) == DECLINED else int(answer)


def request(argv: list[str]) -> bytes:
    """Return a command as a message: everything that its own process would have, except open files."""
    mask = os.umask(0)
    os.umask(mask)
    variables = [f"{name}={value}" for name, value in os.environ.items()]
    return os.fsencode("\0".join([*identity(), os.getcwd(), str(mask), str(len(argv)), *argv, *variables]))


def parse(message: bytes) -> tuple[list[str], str, int, list[str], dict[str, str]]:
    """Return identity, working folder, umask, arguments and environment from a :func:`request`."""
    prefix, file, image, folder, mask, count, *words = os.fsdecode(message).split("\0")
    argv, variables = words[: int(count)], words[int(count) :]
    return [prefix, file, image], folder, int(mask), argv, dict(one.split("=", 1) for one in variables)
