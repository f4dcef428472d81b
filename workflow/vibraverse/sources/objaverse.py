"""Objaverse models by UID, through the ``objaverse`` package and its cache.

Cached data are used without a network: the index of paths, the metadata with licence and author, and the GLB files, in
the package's own layout.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import socket
import zlib
from dataclasses import dataclass
from pathlib import Path

from vibraverse.contract.errors import Refused
from vibraverse.contract.refusal import said

#: Licence code of Sketchfab, the origin of the models -> SPDX identifier.
LICENCES = {
    "by": "CC-BY-4.0",
    "by-sa": "CC-BY-SA-4.0",
    "by-nd": "CC-BY-ND-4.0",
    "by-nc": "CC-BY-NC-4.0",
    "by-nc-sa": "CC-BY-NC-SA-4.0",
    "by-nc-nd": "CC-BY-NC-ND-4.0",
    "cc0": "CC0-1.0",
}


_TIMEOUT_S = 60


@dataclass(frozen=True)
class Model:
    """A fetched model with its title, licence and attribution."""

    path: Path
    title: str
    category: str | None
    licence: str
    attribution: str | None


def fetch(uid: str, cache: str | Path) -> Model:
    """Return the model ``uid`` from the cache folder, or else from the network.

    Raises :class:`Refused` (``unavailable``) if the UID is unknown or the network does not respond.
    """
    folder = Path(cache).expanduser()
    package = _package(folder)
    try:
        # The package reports progress on standard output, which belongs to the caller.
        with _locked(folder), contextlib.redirect_stdout(io.StringIO()):
            if uid not in package._load_object_paths():
                raise Refused(
                    "unavailable",
                    f"Objaverse has no object {uid}.",
                    "Check the UID in sources.objaverse.uids.",
                )
            path = Path(package.load_objects([uid])[uid])
            annotation = package.load_annotations([uid]).get(uid, {})
    except (OSError, EOFError, ValueError, zlib.error) as error:
        raise Refused(
            "unavailable",
            f"The Objaverse object {uid} is not completely cached and could not be fetched ({said(error)}).",
            f"Connect to the network and repeat, or copy the model into the cache folder ({cache}); "
            "delete a damaged file there first.",
        ) from None
    user = annotation.get("user") or {}
    author = " ".join(filter(None, [user.get("displayName") or user.get("username"), annotation.get("uri")]))
    categories = annotation.get("categories") or [{}]
    licence = annotation.get("license") or "unknown"
    return Model(
        path=path,
        title=annotation.get("name") or uid,
        category=categories[0].get("name"),
        licence=LICENCES.get(licence, licence),
        attribution=author or None,
    )


@contextlib.contextmanager
def _locked(folder: Path):
    """Hold the lock of a cache, so that one process at a time fetches, with a timeout on the network."""
    before = socket.getdefaulttimeout()
    socket.setdefaulttimeout(_TIMEOUT_S)
    try:
        with contextlib.ExitStack() as stack:
            with contextlib.suppress(OSError):  # a read-only cache needs no lock
                folder.mkdir(parents=True, exist_ok=True)
                lock = stack.enter_context(open(folder / ".lock", "w"))
                fcntl.flock(lock, fcntl.LOCK_EX)
            yield
    finally:
        socket.setdefaulttimeout(before)


def _package(cache: Path):
    """Return the ``objaverse`` package, pointed at ``cache``."""
    try:
        import objaverse
    except ImportError:
        raise Refused(
            "unavailable",
            "The Python package objaverse is not installed.",
            "Install it, or empty sources.objaverse.uids.",
        ) from None
    objaverse.BASE_PATH = str(cache)
    objaverse._VERSIONED_PATH = str(cache / "hf-objaverse-v1")
    return objaverse
