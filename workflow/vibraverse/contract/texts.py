"""Sentences and texts from files, made fit to be shown and stored. Imports nothing but the standard library."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Sequence
from pathlib import Path

#: The configuration that a run has when none is named.
DEFAULT_CONFIG = "config.yaml"
#: Control characters but white space, and halves of characters: HDF5 holds no NUL, UTF-8 no half.
_UNFIT = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f\ud800-\udfff]")
#: Mistakes that a list of them shows.
_SHOWN = 10
#: A sentence about an unknown name lists so many known ones in their order, of more the nearest, this many.
_MANY, _NEAREST = 40, 20


def storable(text: str) -> str:
    """Return a text with a blank for every character that a file or a terminal cannot be trusted with."""
    return _UNFIT.sub(" ", text)


def unknown(kind: str, name: str, known) -> str:
    """Return the sentence for an unknown name, with the nearest known one and all of them, or the nearest of many."""
    names = [str(each) for each in known]
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    if not names:
        return f"unknown {kind} {str(name)!r} (known: none)"
    if len(names) > _MANY:
        nearest = difflib.get_close_matches(str(name), names, n=_NEAREST, cutoff=0.0)
        names = [*nearest, f"and {len(names) - len(nearest)} more"]
    return f"unknown {kind} {str(name)!r}{hint} (known: {', '.join(names)})"


def listed(subject: str, mistakes: Sequence[str]) -> str:
    """Return that ``subject`` has several mistakes, with the first of them, one to a line."""
    shown = [f"  {mistake}" for mistake in mistakes[:_SHOWN]]
    if len(mistakes) > _SHOWN:
        shown.append(f"  and {len(mistakes) - _SHOWN} more")
    return "\n".join([f"{subject} has {len(mistakes)} mistakes:", *shown])


def advised(*words: str, config: str | Path | None = None, results: str | Path | None = None) -> str:
    """Return a command for a sentence, to be pasted as it stands: the run is named as ``run_arguments`` take it."""
    run = [*(["--config", str(config)] if config else []), *(["--results", str(results)] if results else [])]
    return f"`{shlex.join(['vibraverse', words[0], *run, *words[1:]])}`"


def counted(count: int, thing: str) -> str:
    """Return how many there are, in words: ``1 object``, ``2 objects``."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def duration(seconds: float) -> str:
    """Return a time with two units at most: ``2 d 3 h``, ``7 min 3 s``."""
    whole = max(0, round(seconds))
    for unit, length, smaller, part in (("d", 86400, "h", 3600), ("h", 3600, "min", 60), ("min", 60, "s", 1)):
        if whole >= length:
            rest = whole % length // part
            return f"{whole // length} {unit}" + (f" {rest} {smaller}" if rest else "")
    return f"{whole} s"
