"""Curves of training: rows of means over a few steps, and the speed of the whole."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from vibraverse.contract import products

COLUMNS = (
    "step",
    "learning_rate",
    "loss",
    "gradient_norm",
    "samples_per_s",
    "waiting_share",
    "validation",
)
#: Rows of a whole training, about; validations add theirs.
_ROWS = 500
#: What a row sums up.
_SUMS = ("steps", "samples", "loss", "gradient_norm", "seconds", "waited_s")


class Curves:
    """Rows of :data:`COLUMNS`, each over the steps since the row before it.

    ``loss`` and ``gradient_norm`` are means (the norm before clipping), ``waiting_share`` is the share of time in which
    the step waited for data, ``validation`` the metric that chooses the best weights, or None.
    """

    def __init__(self, steps: int):
        self.rows: list[dict] = []
        self.total = dict.fromkeys(_SUMS, 0.0)
        self._every = math.ceil(steps / _ROWS)
        self._open = dict.fromkeys(_SUMS, 0.0)
        self._last = (0, 0.0)

    def add(
        self,
        step: int,
        learning_rate: float,
        loss: float,
        gradient_norm: float,
        samples: int,
        seconds: float,
        waited_s: float,
    ) -> None:
        """Add a step that took ``seconds``, ``waited_s`` of them waiting for data."""
        for sums in (self._open, self.total):
            for name, value in zip(_SUMS, (1, samples, loss, gradient_norm, seconds, waited_s), strict=True):
                sums[name] += value
        self._last = (step, learning_rate)
        if step % self._every == 0:
            self._close()

    def validated(self, metric: float | None) -> None:
        """Write the validation's metric into the row that ends with the last step."""
        if self._open["steps"]:
            self._close()
        if self.rows:
            self.rows[-1]["validation"] = metric

    def _close(self) -> None:
        step, learning_rate = self._last
        row = {"step": step, "learning_rate": learning_rate, **means(self._open), "validation": None}
        self.rows.append(row)
        self._open = dict.fromkeys(_SUMS, 0.0)

    def state(self) -> dict:
        """Return all of it for a checkpoint."""
        return {"rows": self.rows, "total": self.total, "open": self._open, "last": list(self._last)}

    def restore(self, state: dict) -> None:
        """Go on from the :meth:`state` of a checkpoint."""
        self.rows, self.total, self._open = state["rows"], state["total"], state["open"]
        self._last = tuple(state["last"])


def means(sums: dict[str, float]) -> dict[str, float]:
    """Return mean loss and gradient norm, samples per second and the share of time waiting for data."""
    steps, seconds = max(sums["steps"], 1), max(sums["seconds"], 1e-9)
    return {
        "loss": sums["loss"] / steps,
        "gradient_norm": sums["gradient_norm"] / steps,
        "samples_per_s": sums["samples"] / seconds,
        "waiting_share": sums["waited_s"] / seconds,
    }


def write_csv(path: str | Path, rows: Sequence[dict]) -> None:
    """Write rows of curves as CSV with a header, whole or not at all; None is an empty cell."""
    with products.whole(path) as partial, open(partial, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
