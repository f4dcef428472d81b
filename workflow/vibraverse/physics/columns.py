"""Vectors that become more: a matrix whose columns are appended in blocks without copying the old ones each time."""

from __future__ import annotations

import numpy as np


class Columns:
    """A growing (n, size) array, columns contiguous; :attr:`all` is a view of what is there."""

    def __init__(self, rows: int, capacity: int):
        self._array = np.empty((rows, capacity), order="F")
        self.size = 0

    @property
    def all(self) -> np.ndarray:
        """The columns so far, (n, size)."""
        return self._array[:, : self.size]

    def append(self, block: np.ndarray) -> None:
        """Append the columns of ``block`` (n, k)."""
        needed = self.size + block.shape[1]
        if needed > self._array.shape[1]:
            grown = np.empty((self._array.shape[0], max(needed, self._array.shape[1] * 3 // 2)), order="F")
            grown[:, : self.size] = self.all
            self._array = grown
        self._array[:, self.size : needed] = block
        self.size = needed
