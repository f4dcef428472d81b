"""How a set of products was made: the provenances of many jobs, joined by stage.

Values that all jobs of a stage share are kept; others become ``varies``. Joining is associative, so a shard joins its
objects and the index joins the shards.
"""

from __future__ import annotations

#: Placeholder for a value that differs between jobs.
VARIES = "varies"

_KEPT_KEYS = ("stage_version", "vibraverse", "libraries", "options")


def making_of(provenance: dict) -> dict:
    """Return how one product was made, as ``{stage: {stage_version, vibraverse, libraries, options}}``."""
    return {provenance["stage"]: {key: provenance[key] for key in _KEPT_KEYS}}


def join(makings) -> dict:
    """Join several into one; stages are in the order of first appearance."""
    joined: dict = {}
    for making in makings:
        for stage, how in making.items():
            joined[stage] = _agree(joined[stage], how) if stage in joined else how
    return joined


def _agree(a, b):
    if a == b:
        return a
    if isinstance(a, dict) and isinstance(b, dict):
        keys = dict.fromkeys([*a, *b])
        return {key: _agree(a[key], b[key]) if key in a and key in b else VARIES for key in keys}
    return VARIES
