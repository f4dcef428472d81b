"""Subcommands for people; each module has ``main(argv)``."""

from __future__ import annotations

import argparse


def share(text: str) -> float:
    """Return a share between 0 and 1, as an argument's type."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"a share lies between 0 and 1, not {text!r}")
    return value
