"""Seeds from names, never from time or order."""

from __future__ import annotations

import hashlib


def stable_hash(*parts: str) -> int:
    """Return a 64-bit integer that depends on the strings alone, on every machine for ever."""
    digest = hashlib.sha256("\0".join(parts).encode()).digest()
    return int.from_bytes(digest[:8], "little")


def rng(*parts: str):
    """Return a NumPy generator seeded by the strings, e.g. ``rng(object_id, "hollow")``."""
    import numpy as np

    return np.random.Generator(np.random.PCG64(stable_hash(*parts)))
