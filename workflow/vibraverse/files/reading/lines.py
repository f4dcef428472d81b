"""Text mesh files: their encoding, and their numbered lines with any line ending and of bounded length."""

from __future__ import annotations

import codecs
import io
from collections.abc import Iterator
from typing import BinaryIO

from vibraverse.files.reading.mistakes import Unsupported

#: Byte order marks and the encodings that they announce; a longer one stands before its own beginning.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
    (codecs.BOM_UTF8, "utf-8-sig"),
)
#: Bytes at the start of a text that tell UTF-16 without a mark from other encodings.
_SAMPLE_BYTES = 16
_CHUNK_BYTES = 1 << 20

#: Longest line in bytes; even a polygon of two million corners takes less.
_MAX_LINE = 1 << 24


def as_utf8(file: BinaryIO) -> BinaryIO:
    """Return a text file in UTF-8 without a byte order mark: the file itself, or a copy in memory.

    UTF-16 is told by its mark, or by a zero in every other byte. A file in any other encoding is returned as it is.
    """
    head = file.read(_SAMPLE_BYTES)
    file.seek(0)
    encoding = encoding_of(head)
    if encoding is None:
        return file
    decoder, copy = codecs.getincrementaldecoder(encoding)(), io.BytesIO()
    try:
        while chunk := file.read(_CHUNK_BYTES):
            copy.write(decoder.decode(chunk).encode())
        copy.write(decoder.decode(b"", final=True).encode())
    except UnicodeError:
        raise Unsupported(
            f"it begins like {encoding.removesuffix('-sig').upper()} text and is not", "Save it as UTF-8."
        ) from None
    copy.seek(0)
    return copy


def encoding_of(head: bytes) -> str | None:
    """Return the encoding of a text by its first bytes; None unless they show UTF-16, UTF-32 or a mark of UTF-8."""
    for mark, encoding in _MARKS:
        if head.startswith(mark):
            return encoding
    even, odd = head[0:_SAMPLE_BYTES:2], head[1:_SAMPLE_BYTES:2]
    if len(head) < 4:
        return None
    if 0 not in even and not any(odd):
        return "utf-16-le"
    return "utf-16-be" if 0 not in odd and not any(even) else None


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
