"""The shard of an object and the shards of a slice, from stable hashes of ids: other objects do not matter."""

from __future__ import annotations

from vibraverse.contract.seeds import stable_hash

#: The value of ``slice`` for the run that makes the dataset of all shards, once the slices have made them.
JOIN = "join"


def shard_of(object_id: str, shards: int) -> int:
    """Return the number of the object's shard, 0 ≤ number < ``shards``."""
    return stable_hash(object_id, "shard") % shards


def slice_numbers(text: str) -> tuple[int, int]:
    """Return (i, n) of the slice ``i/n``, 1 ≤ i ≤ n; raise ``ValueError`` with one sentence for anything else."""
    first, _, second = text.partition("/")
    if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise ValueError(f"{text!r} is not a slice; write '{JOIN}', or 3/50 for the third of fifty")


def shards_of_slice(text: str, shards: int) -> list[int]:
    """Return the shards that the slice ``i/n`` makes: those whose number is i - 1 modulo n.

    Each whole shard belongs to exactly one of the n slices, so slices neither share work nor omit any.
    """
    number, slices = slice_numbers(text)
    return list(range(number - 1, shards, slices))
