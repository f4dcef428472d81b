"""GLB (glTF 2.0): a 12-byte header, a JSON chunk and one binary chunk (section 4 of the specification)."""

from __future__ import annotations

import struct
from typing import BinaryIO

from vibraverse.files.formats import Format, MeshData
from vibraverse.files.reading.bounds import Bounds
from vibraverse.files.reading.document import Fields, parse
from vibraverse.files.reading.mistakes import Unsupported

_AS_VERSION_2 = (
    "Open it in a program that reads version 1, such as an older Blender, and export it as glTF 2.0."
)
_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"


def read(file: BinaryIO, bounds: Bounds) -> MeshData:
    """Return the triangles of a GLB in metres, with the parts placed by their nodes."""
    from vibraverse.files.reading.scene import joined

    document, binary = _chunks(file)
    check_version(document)
    mesh, parts, notes, warnings = joined(document, binary, bounds)
    return MeshData(*mesh, 1.0, parts, tuple(notes), tuple(warnings))


def check_version(document: Fields) -> None:
    """Raise :class:`Unsupported` for glTF 1.0, which has objects in place of lists and may state no version."""
    version = str(document.fields("asset").value.get("version", "1.0")) if "asset" in document else "1.0"
    lists = ("scenes", "nodes", "meshes", "accessors")
    old = version.startswith("1.") and any(isinstance(document.value.get(name), dict) for name in lists)
    if old or ("asset" in document and str(document.fields("asset").value.get("version")).startswith("1.")):
        raise Unsupported(f"it is glTF version {version:.8}, and only version 2 is read", _AS_VERSION_2)


def _chunks(file: BinaryIO) -> tuple[Fields, bytes]:
    """Return the JSON document and the binary chunk."""
    head = file.read(20)
    if head[:4] != _MAGIC or len(head) < 20:
        raise ValueError("it does not begin like a GLB file")
    version, _, length, _ = struct.unpack_from("<IIII", head, 4)
    if version != 2:
        raise Unsupported(f"it is glTF version {version}, and only version 2 is read", _AS_VERSION_2)
    if head[16:20] != _JSON:
        raise ValueError("its first chunk is not JSON")
    text = file.read(length)
    if len(text) < length:
        raise ValueError("it ends inside its JSON chunk and seems cut off")
    document = parse(text)
    while len(head := file.read(8)) == 8:
        length, kind = struct.unpack("<I4s", head)
        data = file.read(length)
        if len(data) < length:
            raise ValueError(
                f"it states a chunk of {length} bytes and ends after {len(data)}: it seems cut off"
            )
        if kind == _BIN:
            return document, data
    return document, b""


def glb_bytes(text: bytes, binary: bytes) -> bytes:
    """Return a GLB with a JSON text and a binary chunk."""
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    body = struct.pack("<I4s", len(text), _JSON) + text + struct.pack("<I4s", len(binary), _BIN) + binary
    return struct.pack("<4sII", _MAGIC, 2, 12 + len(body)) + body


def unit_m(file: BinaryIO) -> float:
    """Return the metres per unit."""
    return 1.0


FORMAT = Format("GLB", (".glb",), read, unit_m)
