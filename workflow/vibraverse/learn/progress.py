"""The lines that people read while a network trains."""

from __future__ import annotations

import time
from collections.abc import Callable

from vibraverse.contract.texts import duration

#: Seconds between two lines about steps.
INTERVAL_S = 5.0


class Progress:
    """Says how far training is, at most every :data:`INTERVAL_S` seconds."""

    def __init__(self, say: Callable[[str], None], step: int, steps: int):
        self._say, self._steps = say, steps
        self._first, self._began = step, time.monotonic()
        self._said = self._began

    def stepped(self, step: int, loss: float, rate: float, speed: dict[str, float]) -> None:
        """Say a line about the last step, if it is time for one; ``speed`` as :func:`curves.means` gives it."""
        now = time.monotonic()
        if now - self._said < INTERVAL_S:
            return
        self._said = now
        left = (self._steps - step) * (now - self._began) / (step - self._first)
        self._say(
            f"step {step} of {self._steps}: loss {loss:.4g}, learning rate {rate:.3g}, "
            f"{speed['samples_per_s']:.3g} samples/s, {speed['waiting_share']:.0%} of the time waiting for data, "
            f"{duration(left)} left"
        )

    def validated(self, step: int, metric: str, value: float, best: bool) -> None:
        """Say the metric of a validation."""
        self._say(f"step {step} of {self._steps}: validation {metric} {value:.6g}{' (best so far)' * best}")
