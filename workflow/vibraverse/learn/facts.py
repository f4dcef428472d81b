"""Facts that identify a training or its data: as JSON gives them back, and their hash."""

from __future__ import annotations

import json
from collections.abc import Mapping

from vibraverse.contract import products


def plain(facts: Mapping) -> dict:
    """Return facts as JSON gives them back, so that they compare equal to stored ones."""
    return json.loads(products.as_json(facts))


def identity(facts: Mapping) -> str:
    """Return 12 hexadecimal digits of the hash of facts, whatever the order of their names."""
    return products.text_sha256(json.dumps(plain(facts), sort_keys=True))[:12]
