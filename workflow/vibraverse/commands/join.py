"""``vibraverse join``: show several datasets as one, for instance a workstation's and a cluster's."""

from __future__ import annotations

import argparse
from pathlib import Path

from vibraverse.contract.errors import UsageError
from vibraverse.contract.texts import counted


def main(argv: list[str]) -> int:
    """Write the view and print what it shows."""
    parser = argparse.ArgumentParser(
        prog="vibraverse join",
        description="Write a small HDF5 file that shows the objects of several datasets as one shard. It links to "
        "their shards by paths relative to itself and copies nothing.",
    )
    parser.add_argument(
        "datasets", nargs="+", type=Path, metavar="PATH", help="a dataset's folder, or a shard"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="the view, for instance all.h5"
    )
    chosen = parser.parse_args(argv)

    from vibraverse.dataset.publish.join import join_datasets

    try:
        count = join_datasets(chosen.datasets, chosen.output)
    except (FileNotFoundError, ValueError) as error:
        raise UsageError(str(error)) from None
    print(f"{chosen.output} shows {counted(count, 'object')} of {counted(len(chosen.datasets), 'dataset')}.")
    return 0
