"""Wording shared by messages, and text from files made safe to show and store."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

#: The configuration file of a run that names none.
DEFAULT_CONFIG = "config.yaml"
#: Control characters except white space, and lone surrogates: HDF5 stores no NUL, UTF-8 no surrogate.
_UNSTORABLE = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f\ud800-\udfff]")
#: Mistakes that a message lists.
_SHOWN_MISTAKES = 10
#: Known names that a message about an unknown one lists in their order; if there are more, it lists the nearest.
_MAX_KNOWN, _NEAREST_KNOWN = 40, 20


def storable(text: str) -> str:
    """Return a text with a space for every character that is unsafe in a file or on a terminal."""
    return _UNSTORABLE.sub(" ", text)


def unknown(kind: str, name: str, known) -> str:
    """Return the sentence for an unknown name; it suggests the nearest known name and lists all, or the nearest few."""
    names = [str(each) for each in known]
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    if not names:
        return f"unknown {kind} {str(name)!r} (known: none)"
    if len(names) > _MAX_KNOWN:
        nearest = difflib.get_close_matches(str(name), names, n=_NEAREST_KNOWN, cutoff=0.0)
        names = [*nearest, *and_more(len(names), len(nearest))]
    return f"unknown {kind} {str(name)!r}{hint} (known: {', '.join(names)})"


def listed(subject: str, mistakes: Sequence[str]) -> str:
    """Return the sentence that ``subject`` has several mistakes, and the first of them, one per line."""
    shown = [*mistakes[:_SHOWN_MISTAKES], *and_more(len(mistakes), _SHOWN_MISTAKES)]
    return "\n".join([f"{subject} has {len(mistakes)} mistakes:", *(f"  {line}" for line in shown)])


def advised(*words: str, config: str | Path | None = None, results: str | Path | None = None) -> str:
    """Return a command for a message, ready to paste: it names the run with the options of ``run_arguments``."""
    run = [*(["--config", str(config)] if config else []), *(["--results", str(results)] if results else [])]
    return f"`{shlex.join(['vibraverse', words[0], *run, *words[1:]])}`"


def and_more(count: int, shown: int) -> list[str]:
    """Return the last item of a list that shows ``shown`` of ``count``: ``["and 3 more"]``, or ``[]``."""
    return [f"and {count - shown} more"] if count > shown else []


def counted(count: int, thing: str) -> str:
    """Return a count with its noun: ``1 object``, ``2 objects``."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def duration(seconds: float) -> str:
    """Return a duration in at most two units: ``2 d 3 h``, ``7 min 3 s``."""
    whole = max(0, round(seconds))
    for unit, length, smaller, part in (("d", 86400, "h", 3600), ("h", 3600, "min", 60), ("min", 60, "s", 1)):
        if whole >= length:
            rest = whole % length // part
            return f"{whole // length} {unit}" + (f" {rest} {smaller}" if rest else "")
    return f"{whole} s"
