"""Where an object belongs: its shard, with it its slice, and its split are stable hashes of its id.

Neither time nor order nor the other objects matter, so a growing dataset never moves an object from
training to test. Everything made from one object stands on the same side.
"""

from __future__ import annotations

from vibraverse.seeds import stable_hash

#: Instead of a slice: what is made of all shards, once the slices have made them.
JOIN = "join"


def shard_of(object_id: str, shards: int) -> int:
    """Return the number of the object's shard, 0 ≤ number < ``shards``."""
    return stable_hash(object_id, "shard") % shards


def slice_numbers(text: str) -> tuple[int, int]:
    """Return (i, n) of the slice ``i/n``, 1 ≤ i ≤ n; raise ``ValueError`` with a sentence for anything else."""
    first, _, second = text.partition("/")
    if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise ValueError(f"{text!r} is neither '{JOIN}' nor a slice such as 3/50, the third of fifty")


def shards_of_slice(text: str, shards: int) -> list[int]:
    """Return the shards that the slice ``i/n`` makes: those whose number is i - 1 modulo n.

    A shard belongs to one slice of n, whole, so slices neither share work nor leave any out.
    """
    number, slices = slice_numbers(text)
    return list(range(number - 1, shards, slices))


def split_of(object_id: str, splits: dict[str, float]) -> str:
    """Return the object's split; ``splits`` maps names to shares that add up to 1.

    The hash is a number in [0, 1); the splits divide that interval in the order listed.
    """
    position = stable_hash(object_id, "split") / 2**64
    names = [name for name, share in splits.items() if share > 0]
    for name in names:
        position -= splits[name]
        if position < 0:
            return name
    return names[-1]
