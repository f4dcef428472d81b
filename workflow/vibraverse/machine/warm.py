"""How a stage's command asks a warm process to do its work; what that is and does is in ``warm_process``.

The command has nothing else to do, and there are ten for each object, so that this imports as little as can be.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import zlib

#: The environment variable that holds the address of a warm process; where it is set, if to nothing, none is started.
#: It is a name in Linux's abstract namespace, which leaves no file behind.
VARIABLE = "VIBRAVERSE_WARM"
#: What starts a warm process, behind ``python -m vibraverse``: not for people.
SUBCOMMAND = "warm-process"
#: What goes before a message: its length in bytes.
LENGTH = struct.Struct("!I")
#: What the kernel tells of the process at the other end: its number, its user and group.
_PEER = struct.Struct("3i")
#: The exit status by which a warm process says that it is not the one to do a command; no stage ends with it.
DECLINED = 79


def container() -> str:
    """Return the image that this process runs in; nothing outside of one."""
    return os.environ.get("APPTAINER_CONTAINER") or os.environ.get("SINGULARITY_CONTAINER") or ""


def identity() -> list[str]:
    """Return what a command and the warm process must share: the environment, this file, the image."""
    return [sys.prefix, os.path.realpath(__file__), container()]


def socket_name(address: str) -> str:
    """Return the abstract name at which a warm process listens; there is one for each image of a run."""
    image = container()
    return f"\0{address}-{zlib.crc32(os.fsencode(image)):08x}" if image else f"\0{address}"


def ours(connection: socket.socket) -> bool:
    """Return whether the other end of a connection is this user's: everybody may use an abstract name."""
    return (
        _PEER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))[1]
        == os.getuid()
    )


def ask(address: str, argv: list[str]) -> int | None:
    """Let the warm process at an address do a command; return its exit status, or None where it must be done here."""
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
    """Return what a warm process must know of a command: all that it would have by itself, but for its open files."""
    mask = os.umask(0)
    os.umask(mask)
    variables = [f"{name}={value}" for name, value in os.environ.items()]
    return os.fsencode("\0".join([*identity(), os.getcwd(), str(mask), str(len(argv)), *argv, *variables]))


def understood(message: bytes) -> tuple[list[str], str, int, list[str], dict[str, str]]:
    """Return identity, folder, mask of files, arguments and environment of a :func:`request`."""
    prefix, file, image, folder, mask, count, *words = os.fsdecode(message).split("\0")
    argv, variables = words[: int(count)], words[int(count) :]
    return [prefix, file, image], folder, int(mask), argv, dict(one.split("=", 1) for one in variables)
