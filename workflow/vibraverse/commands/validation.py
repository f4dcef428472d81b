"""``vibraverse validation``: show the computed frequencies of known bodies against their references."""

from __future__ import annotations

import argparse
from pathlib import Path

from vibraverse.contract import products
from vibraverse.contract.errors import UsageError
from vibraverse.contract.readable import unreadable
from vibraverse.flow.paths import Paths


def main(argv: list[str]) -> int:
    """Print a line for each body and order, then the missed tolerances; return 1 if there are any."""
    parser = argparse.ArgumentParser(
        prog="vibraverse validation",
        description="Show how near the computed frequencies of known bodies are; exit 1 when a tolerance is missed. "
        "`snakemake validation` computes them.",
    )
    parser.add_argument(
        "--record",
        type=Path,
        default=Path(Paths().validation_record),
        metavar="FILE",
        help="default: %(default)s",
    )
    parser.add_argument("--verdict", type=Path, metavar="FILE", help="write the outcome here (JSON)")
    chosen = parser.parse_args(argv)
    if wrong := unreadable(
        chosen.record, missing="`snakemake validation` makes it", folder="name validation.json in it"
    ):
        raise UsageError(f"{chosen.record} {wrong}")
    record = products.read_json(chosen.record)
    print(listing(record), end="")
    if chosen.verdict is not None:
        products.write_json(chosen.verdict, {"accepted": not record["missed"], "missed": record["missed"]})
    return 1 if record["missed"] else 0


def listing(record: dict) -> str:
    """Return the comparison as text."""
    lines = [f"{'body':17}{'elements':14}{'frequencies':>11}{'largest error':>15}{'accepted':>10}  against"]
    for body in record["bodies"].values():
        for line in body["summary"]:
            error, accepted = 100 * line["largest_error"], 100 * line["tolerance"]
            lines.append(
                f"{body['title']:17}{line['elements']:14}{line['frequencies']:>11}"
                f"{error:>13.3f} %{accepted:>8.3g} %  {line['source']}"
            )
    lines += ["", f"Missed: {len(record['missed'])}" if record["missed"] else "All within their tolerances."]
    return "\n".join([*lines, *(f"  {sentence}" for sentence in record["missed"])]) + "\n"
