"""Checksums of the content of a group, which trace a wrong byte in a shard to an object and a field.

The SHA-256 of a shard's bytes, in ``dataset.json``, finds any change but not its place. So each object also lists one
checksum per HDF5 group and dataset in it, over what HDF5 returns: names, types, shapes, data, attributes.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np

from vibraverse.dataset import schema
from vibraverse.dataset.schema.stored import attribute, text, value

#: Hexadecimal digits kept of each SHA-256: 64 bits suffice against accidents, and the list stays small.
_DIGITS = 16


def checksums(group) -> dict[str, str]:
    """Return path -> checksum of everything in an HDF5 group except its list of checksums; ``.`` is the group itself.

    Raises the errors that HDF5 raises for damaged bytes.
    """
    found = {".": _of(group, ".")}

    def visit(name, item):
        if name != schema.CHECKSUMS:
            found[name] = _of(item, name)

    group.visititems(visit)
    return found


def differences(group) -> list[str]:
    """Return the paths in an object's group whose content contradicts its list of checksums, in file order.

    Raises :class:`KeyError` if the group has no such list, and the errors that HDF5 raises for damaged bytes.
    """
    stated = json.loads(text(group, schema.CHECKSUMS))
    if not isinstance(stated, dict):
        raise ValueError(f"{schema.CHECKSUMS} is no list of checksums")
    found = checksums(group)
    return [path for path in {**stated, **found} if stated.get(path) != found.get(path)]


def _of(item, path: str) -> str:
    digest = hashlib.sha256()
    for name in sorted(item.attrs):
        digest.update(name.encode() + b"\0")
        _add(digest, attribute(item, name, f"{path}@{name}"))
    if hasattr(item, "keys"):
        digest.update("\0".join(sorted(key for key in item if key != schema.CHECKSUMS)).encode())
    else:
        _add(digest, value(item, path))
    return digest.hexdigest()[:_DIGITS]


def _add(digest, held) -> None:
    """Add a value with its type and shape to a digest: a number, a text, an array, or an array of arrays (pictures)."""
    if isinstance(held, (str, bytes)):
        held = held.encode() if isinstance(held, str) else held
        digest.update(f"text {len(held)} ".encode() + held)
        return
    array = np.ascontiguousarray(held)
    digest.update(f"{array.dtype.str} {np.shape(held)} ".encode())
    if array.dtype == object:
        for entry in array.flat:
            _add(digest, entry)
    else:
        digest.update(array.data if array.nbytes else b"")
