"""Refusals: an object that cannot be processed is a record, not a crash.

The library raises :class:`Refused`. The stage runner then writes one small JSON text, the refusal,
in the place of every product of the stage and exits 0. A later stage that finds a refusal where it
expects an input copies it to its own products, so the reason reaches the dataset and the report
at the cost of a file copy. ``cat`` on any such product shows what happened.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

#: Reasons, and the sentence that a summary shows for each.
REASONS = {
    "unreadable": "the file could not be read as a mesh",
    "empty": "the file holds no triangles",
    "not_finite": "a coordinate is not a finite number",
    "not_a_solid": "the shape bounds no volume",
    "too_large": "the mesh is larger than the configured limit",
    "not_repairable": "the surface could not be made closed and manifold",
    "separate_bodies": "most of the shape lies apart from its largest body",
    "too_thin": "the body or its wall is too thin to resolve",
    "meshing_failed": "no valid tetrahedra could be made",
    "solve_failed": "the vibration modes could not be computed",
    "unavailable": "the source could not be fetched",
    "limit": "a time or memory limit was reached",
}

_MARK = '{"vibraverse_refusal": 1'
_MAX_BYTES = 16384
#: Characters of an error that a refusal quotes.
_MAX_QUOTED = 200


def said(error: Exception) -> str:
    """Return an error's message in one short line without a full stop."""
    return " ".join(str(error).split())[:_MAX_QUOTED].rstrip(".") or type(error).__name__


@dataclass(frozen=True)
class Refusal:
    """A refusal as stored: which object, at which stage, why, and what to do."""

    object: str
    stage: str
    reason: str
    message: str
    advice: str = ""
    solidity: str = ""

    def to_text(self) -> str:
        """Return the text that stands in place of a product."""
        body = json.dumps(asdict(self), ensure_ascii=False)
        text = f"{_MARK}, {body[1:]}\n"
        if len(text.encode()) <= _MAX_BYTES:
            return text
        short = Refusal(self.object, self.stage, self.reason, self.message[:2000] + " …", self.advice[:2000])
        return short.to_text()


def is_refusal(path: str | Path) -> bool:
    """Return whether ``path`` holds a refusal: not a product, and not nothing."""
    try:
        with open(path, "rb") as file:
            return file.read(len(_MARK)) == _MARK.encode()
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        return False


def read_refusal(path: str | Path) -> Refusal | None:
    """Return the refusal stored at ``path``, or None if it holds a product or does not exist."""
    try:
        with open(path, "rb") as file:
            head = file.read(_MAX_BYTES)
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        return None
    if not head.startswith(_MARK.encode()):
        return None
    fields = json.loads(head)
    fields.pop("vibraverse_refusal")
    return Refusal(**fields)
