"""Numbered lines of text mesh files, with any line ending and of bounded length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

#: Longest line in bytes; even a polygon of two million corners takes less.
_MAX_LINE = 1 << 24


def lines(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield the numbered lines of a text; they may end with \\n, \\r\\n or \\r.

    Lines are read ahead: after the first one ``file.tell()`` may be anywhere. A reader that compares sizes measures the
    whole file.
    """
    start = file.tell()
    head = file.read(1 << 16)
    file.seek(start)
    found = (
        _returns(file) if b"\r" in head and b"\n" not in head else iter(lambda: file.readline(_MAX_LINE), b"")
    )
    for number, line in enumerate(found, 1):
        if len(line) >= _MAX_LINE:
            raise ValueError(f"line {number} is longer than {_MAX_LINE >> 20} MB")
        yield number, line


def _returns(file: BinaryIO) -> Iterator[bytes]:
    """Yield the lines of a file that end with a single \\r."""
    rest = b""
    while len(rest) < _MAX_LINE and (chunk := file.read(1 << 20)):
        *found, rest = (rest + chunk).split(b"\r")
        yield from (line + b"\n" for line in found)
    yield rest


def joined(numbered: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    """Yield lines, joining those that end with a backslash to the next."""
    parts, length = [], 0
    for number, line in numbered:
        length += len(line)
        if length > _MAX_LINE:
            raise ValueError(f"line {number} is longer than {_MAX_LINE >> 20} MB")
        if line.endswith((b"\\\n", b"\\\r\n")):
            parts.append(line.rstrip()[:-1] + b" ")
            continue
        yield number, b"".join([*parts, line])
        parts, length = [], 0
    if parts:
        yield number, b"".join(parts)


def rows(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield the numbered lines that hold more than a comment."""
    for number, line in lines(file):
        row = line.partition(b"#")[0].strip()
        if row:
            yield number, row


def invalid(number: int, line: bytes) -> ValueError:
    """Return the error for a line that cannot be read."""
    text = line.strip()[:60].decode("utf-8", "replace")
    return ValueError(f"line {number} is not valid: {text}")
