"""Reports of a long computation: what it does, said while it does it.

A report goes to the log of the stage. A child process of :func:`vibraverse.contract.limits.run_limited` hands it to its
parent, and a command for people shows it on their terminal.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


def _print(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


_listeners: list[Callable[[str], None]] = [_print]


def report(sentence: str) -> None:
    """Say what a computation does or found, in one line; it goes to the log unless somebody else listens."""
    _listeners[-1](sentence)


@contextmanager
def reports_to(listener: Callable[[str], None]) -> Iterator[None]:
    """Let ``listener`` have the reports of this process."""
    _listeners.append(listener)
    try:
        yield
    finally:
        _listeners.pop()
