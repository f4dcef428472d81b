"""``vibraverse check``: check every byte and every field of a dataset, and the physics of a sample."""

from __future__ import annotations

import argparse
from pathlib import Path

from vibraverse.commands import share
from vibraverse.contract.errors import UsageError
from vibraverse.contract.texts import advised, and_more
from vibraverse.flow.paths import Paths

#: Findings that are printed.
_SHOWN_FINDINGS = 50


def main(argv: list[str]) -> int:
    """Print a line per finding, file and object first; return 1 if there are any."""
    parser = argparse.ArgumentParser(
        prog="vibraverse check",
        description="Check a dataset's folder, or one shard: checksums, types, shapes, units and ranges of every "
        "field, the equations that its numbers satisfy, and of a sample the frequencies and mode shapes recomputed "
        "from the basis and the sounds from the modes. Ends with exit code 1 when anything is wrong.",
    )
    parser.add_argument(
        "dataset", nargs="?", type=Path, default=Path("results/dataset"), metavar="PATH",
        help="the dataset's folder, or a shard (default results/dataset)",
    )  # fmt: skip
    parser.add_argument(
        "--sample", type=share, default=0.1, metavar="SHARE",
        help="share of the items to recompute, 0 to 1 (default 0.1)",
    )  # fmt: skip
    chosen = parser.parse_args(argv)

    from vibraverse.dataset.check.folder import findings

    wrong = 0
    try:
        for finding in findings(chosen.dataset, chosen.sample):
            wrong += 1
            if wrong <= _SHOWN_FINDINGS:
                print(finding, flush=True)
    except FileNotFoundError as error:
        raise UsageError(str(error)) from None
    for more in and_more(wrong, _SHOWN_FINDINGS):
        print(more)
    if wrong:
        print(
            f"{chosen.dataset}: {wrong} finding{'s' * (wrong > 1)}; {_repair(chosen.dataset)} says what to rebuild."
        )
        return 1
    share_made = f"{chosen.sample:.0%} of its items recomputed" if chosen.sample else "nothing recomputed"
    print(f"{chosen.dataset} is as it was written, and agrees with itself ({share_made}).")
    return 0


def _repair(dataset: Path) -> str:
    """Return the repair command for the run that made a dataset or a shard, as far as its path shows the run."""
    folder = dataset.parent.parent if dataset.is_file() else dataset
    folder = folder if folder.name else folder.resolve()  # "." has no name
    if Path(Paths(folder.parent).dataset) == folder:
        return advised("repair", results=folder.parent)
    return "`vibraverse repair`, with the --config or --results of the run that made it,"
