"""Pack a .gltf with its neighbours into one GLB.

A GLB (glTF 2.0, section 4) is a 12-byte header, a JSON chunk and one binary chunk. All buffers are
appended to that chunk and the buffer views into them move along; images become buffer views too.
"""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from urllib.parse import unquote

from vibraverse.files.formats.bounds import MAX_BYTES, TooLarge

_MAGIC, _JSON, _BIN = b"glTF", b"JSON", b"BIN\0"
_IMAGE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


def pack(data: bytes, folder: Path) -> bytes:
    """Return the GLB that holds the glTF JSON ``data`` and the files it refers to, relative to ``folder``.

    An image that is not there is dropped, because geometry does not need it. Raises ``ValueError`` when
    ``data`` is not glTF 2.0 and ``FileNotFoundError`` when a buffer is missing.
    """
    try:
        document = json.loads(data)
    except UnicodeDecodeError:
        raise ValueError("it is no text") from None
    if not isinstance(document, dict) or "asset" not in document:
        raise ValueError("this is JSON, but not glTF")
    views = document.setdefault("bufferViews", [])
    blob = bytearray()
    starts = []
    for buffer in document.get("buffers", []):
        starts.append(_append(blob, _fetch(buffer["uri"], folder)))
    for view in views:
        view["byteOffset"] = starts[view.get("buffer", 0)] + view.get("byteOffset", 0)
        view["buffer"] = 0
    for image in document.get("images", []):
        uri = image.pop("uri", None)
        if uri is None:
            continue
        try:
            content = _fetch(uri, folder)
        except OSError:
            content = b""
        start = _append(blob, content)
        image["bufferView"] = len(views)
        image.setdefault("mimeType", _IMAGE_TYPES.get(Path(uri[:200]).suffix.lower(), "image/png"))
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(content)})
    _pad(blob, b"\0")
    document["buffers"] = [{"byteLength": len(blob)}]
    text = bytearray(json.dumps(document, separators=(",", ":")).encode())
    _pad(text, b" ")
    body = struct.pack("<I4s", len(text), _JSON) + text + struct.pack("<I4s", len(blob), _BIN) + blob
    return struct.pack("<4sII", _MAGIC, 2, 12 + len(body)) + body


def data_uri(uri: str) -> bytes:
    """Return the bytes that a data URI holds; ``ValueError`` for the name of a file."""
    if not uri.startswith("data:"):
        raise ValueError(f"it refers to {uri[:60]!r}, which is not in it")
    return base64.b64decode(uri.partition(",")[2])


def _fetch(uri: str, folder: Path) -> bytes:
    """Return the bytes of a data URI or of a file beside the document."""
    if uri.startswith("data:"):
        return data_uri(uri)
    path = Path(unquote(uri))
    if path.is_absolute() or ".." in path.parts or "://" in uri:
        raise ValueError(f"it refers to {uri!r}, which does not lie beside it")
    neighbour = folder / path
    if not neighbour.is_file():
        raise FileNotFoundError(f"its buffer {uri} is missing")
    if neighbour.stat().st_size > MAX_BYTES:
        raise TooLarge(f"refers to {uri}, a file of more than {MAX_BYTES >> 20} MB")
    return neighbour.read_bytes()


def _append(blob: bytearray, content: bytes) -> int:
    """Append ``content`` at a multiple of four bytes and return where it starts."""
    _pad(blob, b"\0")
    start = len(blob)
    blob += content
    return start


def _pad(blob: bytearray, filler: bytes) -> None:
    blob += filler * (-len(blob) % 4)
