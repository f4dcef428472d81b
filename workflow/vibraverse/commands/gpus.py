"""``vibraverse gpus``: list the GPUs of this machine, or run a command with GPUs that it has claimed."""

from __future__ import annotations

import argparse
import os
import signal

from vibraverse.contract.errors import UsageError
from vibraverse.machine import gpus


def main(argv: list[str]) -> int:
    """List GPUs, or claim some and execute a command."""
    parser = argparse.ArgumentParser(
        prog="vibraverse gpus",
        usage="vibraverse gpus [--claim N [--wait S] COMMAND …]",
        description="List the GPUs that this process may use, or run a command with N of them that no other such "
        "command has. It sees only those (CUDA_VISIBLE_DEVICES), or none for 0, and has them until it and what it "
        "started end.",
    )
    parser.add_argument("--claim", type=int, metavar="N", help="how many the command gets")
    parser.add_argument(
        "--wait",
        type=float,
        default=float("inf"),
        metavar="S",
        help="for at most so many seconds (default: for ever)",
    )
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="COMMAND")
    chosen = parser.parse_args(argv)
    command = chosen.command[1:] if chosen.command[:1] == ["--"] else chosen.command
    if chosen.claim is None:
        if command:
            raise UsageError(
                "the command does not say how many GPUs it needs; write `vibraverse gpus --claim 1 COMMAND …`"
            )
        return _list()
    if chosen.claim < 0 or not command:
        raise UsageError(
            "--claim must be 0 or more and needs a command after it; write `vibraverse gpus --claim 1 COMMAND …`"
        )
    try:
        with gpus.Claim(chosen.claim, chosen.wait, inherited=True):
            signal.signal(
                signal.SIGPIPE, signal.SIG_DFL
            )  # Python ignores it, and the program would inherit that
            os.execvp(command[0], command)
    except gpus.NoGPU as missing:
        raise UsageError(str(missing)) from None
    except OSError as error:
        raise UsageError(
            f"{command[0]} cannot be run: {error.strerror}; check its name and the PATH"
        ) from None


def _list() -> int:
    found = gpus.visible()
    if not found:
        print("No GPU is visible here: nvidia-smi finds none, or CUDA_VISIBLE_DEVICES hides them.")
        return 0
    print(f"{'GPU':>3}  {'name':<28}{'MB':>8}{'used':>8}  claimed  UUID")
    for gpu in found:
        claimed = "yes" if gpus.claimed(gpu) else "no"
        print(f"{gpu.index:>3}  {gpu.name:<28}{gpu.memory_mb:>8}{gpu.used_mb:>8}  {claimed:<7}  {gpu.uuid}")
    return 0
