"""Object ids, made from the paths of files."""

from __future__ import annotations

import unicodedata

from vibraverse.contract.seeds import stable_hash

_MAX_ID_LENGTH = 80
_LETTERS = str.maketrans(
    {"ß": "ss", "æ": "ae", "ø": "o", "œ": "oe", "đ": "d", "ð": "d", "þ": "th", "ł": "l", "ı": "i"}
)


def slug(text: str) -> str:
    """Return ``text`` as an id of lower-case ASCII letters, digits, ``-`` and ``_``.

    Accents are dropped. A hash replaces letters without an ASCII form and the end of a long text.
    """
    lower = text.lower().translate(_LETTERS)
    plain = "".join(c for c in unicodedata.normalize("NFKD", lower) if not unicodedata.combining(c))
    kept = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "-" for c in plain)
    short = "-".join(part for part in kept.split("-") if part)
    lost = any(c.isalnum() and not c.isascii() for c in plain)
    if lost or not short or len(short) > _MAX_ID_LENGTH:
        short = "-".join(part for part in (short[: _MAX_ID_LENGTH - 9].strip("-"), short_hash(text)) if part)
    return short


def short_hash(text: str) -> str:
    """Return a hash of a text in eight hexadecimal digits, the same for all Unicode forms of its accents."""
    return f"{stable_hash('file', unicodedata.normalize('NFC', text)) & 0xFFFFFFFF:08x}"
