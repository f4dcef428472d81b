"""glTF 2.0: a JSON document with buffers in files beside it, packed into one GLB.

All buffers are appended to the binary chunk of the GLB, and the offsets of their buffer views are adjusted. Images
become buffer views too.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from urllib.parse import unquote

from vibraverse.files.formats import Format, glb
from vibraverse.files.reading.bounds import MAX_BYTES, TooLarge
from vibraverse.files.reading.document import data_uri, parse
from vibraverse.files.reading.extensions import check

_IMAGE_TYPES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}


def pack(data: bytes, folder: Path) -> bytes:
    """Return the GLB that holds the glTF JSON ``data`` and the files it refers to, relative to ``folder``.

    A missing image becomes empty, because geometry does not need it. Raises ``ValueError`` if ``data`` is not glTF 2.0,
    ``OSError`` if a buffer is missing, and :class:`TooLarge`.
    """
    document = parse(data)
    glb.check_version(document)
    if "asset" not in document:
        raise ValueError("this is JSON, but not glTF")
    if any("uri" not in buffer for buffer in document.items("buffers")):
        check(document)  # a compressed mesh has a buffer without content
    blob = bytearray()
    starts = [_append(blob, _fetch(buffer.text("uri"), folder)) for buffer in document.items("buffers")]
    for view in document.items("bufferViews"):
        buffer = view.whole("buffer", 0)
        if buffer >= len(starts):
            raise ValueError(f"it has no buffers[{buffer}]")
        view.value["byteOffset"] = starts[buffer] + view.whole("byteOffset", 0)
        view.value["buffer"] = 0
    views = document.value["bufferViews"] = document.value.get("bufferViews") or []
    for image in document.items("images"):
        if "uri" not in image:
            continue
        uri = image.text("uri")
        del image.value["uri"]
        try:
            content = _fetch(uri, folder)
        except OSError:
            content = b""
        start = _append(blob, content)
        image.value["bufferView"] = len(views)
        image.value.setdefault("mimeType", _IMAGE_TYPES.get(Path(uri[:200]).suffix.lower(), "image/png"))
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(content)})
    _pad(blob)
    document.value["buffers"] = [{"byteLength": len(blob)}]
    try:
        text = json.dumps(document.value, separators=(",", ":")).encode()
    except RecursionError:
        raise ValueError("its JSON is nested too deeply") from None
    return glb.glb_bytes(text, bytes(blob))


def _fetch(uri: str, folder: Path) -> bytes:
    """Return the bytes of a data URI or of a file beside the document."""
    if uri.startswith("data:"):
        return data_uri(uri)
    path = Path(unquote(uri))
    if path.is_absolute() or ".." in path.parts or "://" in uri:
        raise ValueError(f"it refers to {uri[:60]!r}, which does not lie beside it")
    neighbour = folder / path
    if not os.path.isfile(neighbour):  # also false for names that the system does not allow
        raise FileNotFoundError(f"its buffer {uri[:60]} is missing")
    if neighbour.stat().st_size > MAX_BYTES:
        raise TooLarge(f"refers to {uri[:60]}, a file of more than {MAX_BYTES >> 20} MB")
    return neighbour.read_bytes()


def _append(blob: bytearray, content: bytes) -> int:
    """Append ``content`` at a multiple of four bytes and return where it starts."""
    if len(blob) + len(content) > MAX_BYTES:
        raise TooLarge(f"refers to more than {MAX_BYTES >> 20} MB")
    _pad(blob)
    start = len(blob)
    blob += content
    return start


def _pad(blob: bytearray) -> None:
    blob += b"\0" * (-len(blob) % 4)


FORMAT = Format("glTF", (".gltf",), glb.read, glb.unit_m, pack, packed=glb.FORMAT.key)
