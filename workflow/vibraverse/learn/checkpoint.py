"""Checkpoints: training as it stood after a step, written whole, and refused to any other training.

A checkpoint is a folder ``step-00000120`` of the work folder. ``state.pt`` holds the tensors, ``checkpoint.json`` the
facts (see :func:`~vibraverse.learn.train.train`), versions, and the SHA-256 of the former.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import torch

from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.texts import and_more
from vibraverse.learn.facts import plain

#: Checkpoints that are kept: the newest, and the one before in case it is damaged.
KEPT = 2
_STATE, _RECORD = "state.pt", "checkpoint.json"
#: Fields that a message about other facts shows.
_SHOWN_FIELDS = 8


class Checkpoints:
    """The checkpoints in a work folder that belong to a training with these ``facts``."""

    def __init__(self, folder: str | Path, facts: Mapping, versions: Mapping[str, str]):
        self.folder = Path(folder)
        self._facts, self._versions = plain(facts), dict(versions)

    def save(self, step: int, state: dict) -> Path:
        """Write the state after a step, then remove all but the last :data:`KEPT`; return its folder.

        ``state`` holds dictionaries, lists, tensors, numbers and texts. Raises :class:`NotStored` if it cannot be
        written; the older checkpoints are then as before.
        """
        # In memory first: torch's own writer hides the system's error, and only a Python file reports a full disk.
        image = io.BytesIO()
        torch.save(state, image)
        content = image.getvalue()  # not getbuffer(): with an error's traceback it crashes Python 3.12.1
        path = self.folder / f"step-{step:08d}"
        record = {
            "step": step,
            "sha256": hashlib.sha256(content).hexdigest(),
            "facts": self._facts,
            "versions": self._versions,
        }
        with products.whole(path) as partial:
            partial.mkdir()
            (partial / _STATE).write_bytes(content)
            (partial / _RECORD).write_text(products.as_json(record), encoding="utf-8")
        for old in self._paths()[KEPT:]:
            products.remove(old)
        return path

    def newest(self, say: Callable[[str], None] = print) -> int | None:
        """Return the step of the newest whole checkpoint, or None; remove damaged ones and a killed run's leftovers.

        Raises :class:`UsageError` if it belongs to another training.
        """
        for stale in self.folder.glob(".*.partial.*"):
            products.remove(stale)
        for path in self._paths():
            wrong = self._damage(path)
            if not wrong:
                return int(path.name.removeprefix("step-"))
            say(f"warning: the checkpoint {path} is damaged ({wrong}); training goes on from an older one")
            products.remove(path)
        return None

    def load(self, step: int) -> dict:
        """Return the state after a step, with its tensors on the CPU."""
        return torch.load(
            self.folder / f"step-{step:08d}" / _STATE, map_location="cpu", weights_only=True, mmap=False
        )

    def _paths(self) -> list[Path]:
        """Return the folders of checkpoints, the newest first."""
        found = [path for path in self.folder.glob("step-*") if re.fullmatch(r"step-\d{8,}", path.name)]
        return sorted(found, key=lambda path: int(path.name.removeprefix("step-")), reverse=True)

    def _damage(self, path: Path) -> str:
        """Return what is wrong with a checkpoint, or ""; raise :class:`UsageError` if it is another training's."""
        try:
            record = products.read_json(path / _RECORD)
            facts, expected = record["facts"], record["sha256"]
        except (FileNotFoundError, ValueError, LookupError, TypeError):
            return f"{_RECORD} cannot be read"
        if differences := _differences(facts, self._facts):
            shown = [*differences[:_SHOWN_FIELDS], *and_more(len(differences), _SHOWN_FIELDS)]
            raise UsageError(
                f"the checkpoint {path} belongs to another training: {'; '.join(shown)}. A checkpoint continues only "
                f"the training that wrote it; undo the change, or remove {self.folder} to train anew"
            )
        try:
            found = products.sha256(path / _STATE)
        except FileNotFoundError:
            return f"{_STATE} does not exist"
        return "" if found == expected else f"{_STATE} is not what was written"


def _differences(stored, current, name: str = "") -> list[str]:
    """Return a phrase for each field that differs, with its dotted name."""
    if isinstance(stored, dict) and isinstance(current, dict):
        found = []
        for key in [*stored, *(key for key in current if key not in stored)]:
            inner = f"{name}.{key}" if name else str(key)
            found += _differences(stored.get(key), current.get(key), inner)
        return found
    if stored == current:
        return []
    before, now = (json.dumps(value, ensure_ascii=False) for value in (stored, current))
    return [f"{name or 'facts'} was {before} and is {now}"]
