"""The error for a file that is whole but holds what is not read."""

from __future__ import annotations


class Unsupported(ValueError):
    """A file holds something that is not read, though nothing is damaged.

    The message completes "the file could not be read: …"; ``advice`` says how to export the file without it.
    """

    def __init__(self, message: str, advice: str):
        super().__init__(message)
        self.advice = advice
