"""Signals that ask training to end soon: it finishes its step, writes a checkpoint and stops."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from vibraverse.contract.errors import NotThere

#: SIGTERM: a scheduler, a container or a person ends the job. SIGUSR1: Slurm's early warning (``--signal=USR1@120``).
SIGNALS = (signal.SIGTERM, signal.SIGUSR1)


class Interrupted(NotThere):
    """A signal ended training after it wrote a checkpoint; the same command goes on from there.

    The machine is wanted elsewhere: nothing is wrong with the object or the request, and a retry helps. So this is a
    :class:`NotThere`, with the step in :attr:`step`.
    """

    def __init__(self, message: str, step: int):
        super().__init__(message)
        self.step = step

    def __reduce__(self):
        return (Interrupted, (str(self), self.step))


class Signals:
    """A context that notes :data:`SIGNALS` in :attr:`caught` instead of ending the process.

    Only the main thread receives signals; in another thread the context does nothing.
    """

    def __init__(self):
        self.caught = ""
        self._before = {}

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def _note(self, number: int, frame) -> None:
        self.caught = signal.Signals(number).name

    def __exit__(self, *_) -> None:
        for number, handler in self._before.items():
            # None: a handler that was not set from Python, which Python cannot set again.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


@contextmanager
def held_back() -> Iterator[None]:
    """Hold :data:`SIGNALS` back until the end; processes that are started meanwhile hold them back for ever."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def obey_parent(worker: int) -> None:
    """Let a data worker end at :data:`SIGNALS` of its training process only; it was started :func:`held_back`.

    Schedulers signal all processes of a job at once. A worker that ended then would take the last step with it.
    """
    parent = os.getppid()

    def wait() -> None:
        while signal.sigwaitinfo(SIGNALS).si_pid != parent:
            pass
        os._exit(0)

    threading.Thread(target=wait, daemon=True).start()
