"""The zip package of a 3MF file: its parts by name, unpacked as a stream, and its start part."""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import BinaryIO
from xml.parsers import expat

from vibraverse.contract.refusal import said
from vibraverse.files.reading.bounds import MAX_BYTES, TooLarge
from vibraverse.files.reading.mistakes import Unsupported

_CHUNK_BYTES = 1 << 20
#: Most bytes of a part without an element.
_MAX_SILENT_BYTES = 1 << 24
_RELATIONSHIPS = "_rels/.rels"
#: End of the type of the relationship that names the start part (open packaging conventions; 3MF core, chapter 2).
_START_PART = "/3dmodel"
#: Exceptions of the standard library for packages that are damaged, encrypted or compressed by an unknown method.
_DAMAGED = (
    EOFError,
    LookupError,
    NotImplementedError,
    OSError,
    OverflowError,
    RuntimeError,
    ValueError,
    lzma.LZMAError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


class Stop(Exception):
    """Raised by the handler of an element to end the parsing of a part early."""


@contextmanager
def _opened() -> Iterator[None]:
    """Raise ``ValueError`` for exceptions of the standard library; only calls into it belong inside."""
    try:
        yield
    except _DAMAGED as error:
        raise ValueError(f"its package is damaged ({said(error)})") from None


class Package:
    """The parts of a package; names are compared without case and without a leading slash."""

    def __init__(self, file: BinaryIO):
        with _opened():
            self.archive = zipfile.ZipFile(file)
        self.names = {name.lstrip("/").lower(): name for name in self.archive.namelist()}
        self._left = MAX_BYTES
        if any(name.endswith("keystore.xml") for name in self.names):
            raise Unsupported(
                "its models are encrypted (3MF secure content)", "Export it without encryption."
            )

    def start(self) -> str:
        """Return the name of the model that holds the build."""
        targets = []

        def element(name: str, attributes: dict[str, str]) -> None:
            if name == "Relationship" and attributes.get("Type", "").endswith(_START_PART):
                targets.append(attributes.get("Target", "").lstrip("/").lower())

        if _RELATIONSHIPS in self.names:
            self.parse(_RELATIONSHIPS, element)
        models = [name for name in targets if name in self.names]
        models = models or [name for name in self.names if name.endswith("3dmodel.model")]
        models = models or [name for name in self.names if name.endswith(".model")]
        if not models:
            raise ValueError("the package holds no 3D model")
        return models[0]

    def parse(
        self,
        name: str,
        element: Callable[[str, dict[str, str]], None],
        end: Callable[[str], None] | None = None,
        unbounded: bool = False,
    ) -> None:
        """Call ``element`` with the local name and the attributes of every element of an XML part, and ``end`` after.

        ``unbounded`` leaves the size of the part out of the limit, for a look at its beginning. Raises ``ValueError``
        and :class:`TooLarge`; :class:`Stop` from a handler ends the parsing.
        """
        info = self.archive.getinfo(self.names[name])
        self._left -= 0 if unbounded else info.file_size
        if self._left < 0:
            raise TooLarge(f"unpacks into more than {MAX_BYTES >> 20} MB")
        count = 0

        def start(full: str, attributes: dict[str, str]) -> None:
            nonlocal count
            count += 1
            element(full.rpartition(":")[2], attributes)

        parser = expat.ParserCreate()
        parser.StartElementHandler = start
        parser.StartDoctypeDeclHandler = _doctype
        parser.XmlDeclHandler = _declaration
        if end is not None:
            parser.EndElementHandler = lambda full: end(full.rpartition(":")[2])
        silent = 0
        try:
            for piece in self._unpacked(info):
                before = count
                parser.Parse(piece)
                silent = 0 if count > before else silent + len(piece)
                if silent > _MAX_SILENT_BYTES:
                    raise ValueError(f"its model has {silent >> 20} MB without an element")
            parser.Parse(b"", True)
        except Stop:
            return
        except expat.ExpatError as error:
            raise ValueError(f"its model is no valid XML ({error})") from None

    def _unpacked(self, info: zipfile.ZipInfo) -> Iterator[bytes]:
        """Yield the bytes of a part in chunks."""
        with _opened():
            stream = self.archive.open(info)
        with stream:
            while True:
                with _opened():
                    piece = stream.read(_CHUNK_BYTES)
                if not piece:
                    return
                yield piece


def _declaration(version: str, encoding: str | None, standalone: int) -> None:
    try:
        " ".encode(encoding or "utf-8")
    except (LookupError, ValueError):
        raise ValueError(f"its model has the unknown encoding {encoding!r:.40}") from None


def _doctype(*_) -> None:
    raise ValueError("its model has a document type declaration, which 3MF forbids")
