"""The kinds of failure. Edges catch these by name.

:class:`Refused`: the object cannot be processed; a record, exit status 0. :class:`UsageError`: the request is wrong;
one sentence, exit status 2, nothing written. :class:`NotStored` and :class:`NotThere`: the machine failed; one
sentence, exit status 1, and a cluster retries. :data:`PROGRAMMING` lists errors in code, which keep their traceback.
"""

from __future__ import annotations

from vibraverse.contract.refusal import REASONS
from vibraverse.contract.texts import storable

#: Programming errors. They are never turned into a refusal, not in a child process either.
PROGRAMMING = (AssertionError, AttributeError, ImportError, NameError, NotImplementedError, TypeError)


class UsageError(Exception):
    """The request is wrong: one sentence, exit status 2, nothing written."""


class NotStored(Exception):
    """A product cannot be stored: one sentence that says where, why and what to do; exit status 1."""


class NotThere(Exception):
    """The machine lacks something that the command needs: one sentence with the remedy, exit status 1."""


class ChildFailed(Exception):
    """A programming error in a limited child process; the message is the child's traceback."""


class Refused(Exception):
    """An object that cannot be processed; becomes a refusal record.

    ``reason`` is a key of :data:`REASONS`, ``message`` says what is wrong, ``advice`` what the owner of the object
    can do.
    """

    def __init__(self, reason: str, message: str, advice: str = ""):
        if reason not in REASONS:
            raise ValueError(f"unknown refusal reason {reason!r}; known: {', '.join(REASONS)}")
        message, advice = storable(message), storable(advice)  # both may quote a file
        super().__init__(message)
        self.reason, self.message, self.advice = reason, message, advice

    def __reduce__(self):
        return (Refused, (self.reason, self.message, self.advice))

    def __str__(self) -> str:
        return f"{self.message} {self.advice}".strip()
