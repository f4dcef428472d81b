"""Where an object belongs: its shard and its split are stable hashes of its id.

Neither time nor order nor the other objects matter, so a growing dataset never moves an object from
training to test. Everything made from one object stands on the same side.
"""

from __future__ import annotations

from vibraverse.seeds import stable_hash


def shard_of(object_id: str, shards: int) -> int:
    """Return the number of the object's shard, 0 ≤ number < ``shards``."""
    return stable_hash(object_id, "shard") % shards


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
