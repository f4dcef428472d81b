"""Which samples are in which step, and seeds of everything random in training.

All of it is a function of the seed and of numbers that name a place in training. So resuming needs the step alone, and
neither data workers nor the number of processes change what a sample is.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from vibraverse.contract.seeds import rng, stable_hash

#: A sample of an epoch: (epoch, index in the split).
Key = tuple[int, int]


@lru_cache(maxsize=4)
def permutation(seed: int, epoch: int, count: int) -> np.ndarray:
    """Return the order of ``count`` samples in an epoch, (count,) indices."""
    order = rng("order", str(seed), str(epoch)).permutation(count)
    order.setflags(write=False)  # it is shared by the cache
    return order


def step_keys(seed: int, step: int, count: int, batch: int, rank: int = 0, ranks: int = 1) -> list[Key]:
    """Return the keys of the samples that process ``rank`` of ``ranks`` takes in a step; ``step`` counts from 0.

    Epochs follow each other without a gap, so every sample occurs once in each, and all batches are full. A batch that
    crosses from one epoch to the next may hold a sample twice. ``batch`` counts all processes' samples and is a
    multiple of ``ranks``; each process takes a contiguous part.
    """
    share = batch // ranks
    first = step * batch + rank * share
    keys = []
    for place in range(first, first + share):
        epoch, position = divmod(place, count)
        keys.append((epoch, int(permutation(seed, epoch, count)[position])))
    return keys


class StepKeys:
    """The keys of every step from ``start`` to before ``stop``: a batch sampler for a data loader."""

    def __init__(
        self, seed: int, start: int, stop: int, count: int, batch: int, rank: int = 0, ranks: int = 1
    ):
        self._steps = range(start, stop)
        self._seed, self._place = seed, (count, batch, rank, ranks)

    def __len__(self) -> int:
        return len(self._steps)

    def __iter__(self) -> Iterator[list[Key]]:
        for step in self._steps:
            yield step_keys(self._seed, step, *self._place)


def item_rng(seed: int, epoch: int, index: int) -> np.random.Generator:
    """Return the generator of what is random in one sample of one epoch."""
    return rng("item", str(seed), str(epoch), str(index))


def step_seed(seed: int, step: int, rank: int = 0) -> int:
    """Return the 64-bit seed of the global random generators in a step of a process."""
    return stable_hash("step", str(seed), str(step), str(rank))


def named_seed(seed: int, name: str) -> int:
    """Return the 64-bit seed of what is done once, such as the network's first weights."""
    return stable_hash(name, str(seed))
