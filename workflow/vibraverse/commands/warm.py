"""``vibraverse warm``: a run whose jobs are forked from one warm process instead of started anew."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from vibraverse.cli import UsageError
from vibraverse.warm import VARIABLE
from vibraverse.warm_process import Warm


def main(argv: list[str]) -> int:
    """Run a command beside a warm process; return its exit status."""
    if not argv or argv[0] in ("-h", "--help"):
        print(
            "usage: vibraverse warm COMMAND …      for example: vibraverse warm snakemake --cores 4\n\n"
            "Run a command, and do the jobs it starts in forks of one process in which every library is imported\n"
            "already. For many small objects on one machine; see docs/cluster.md."
        )
        return 0 if argv else 2
    with Warm() as warm:
        signal.signal(
            signal.SIGINT, signal.SIG_IGN
        )  # Ctrl-C is for the command; this process waits for its end
        try:
            process = subprocess.Popen(
                argv,
                env={**os.environ, VARIABLE: warm.address},
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
            )
        except OSError as error:
            raise UsageError(f"cannot run {argv[0]}: {error.strerror}") from None
        signal.signal(signal.SIGTERM, lambda number, _: process.send_signal(number))
        status = process.wait()
    sys.stdout.flush()
    return status if status >= 0 else 128 - status
