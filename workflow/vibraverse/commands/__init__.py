"""Subcommands for people; each module has ``main(argv)``."""

from __future__ import annotations

import argparse
from pathlib import Path

from vibraverse.contract.texts import DEFAULT_CONFIG


def run_arguments() -> argparse.ArgumentParser:
    """Return the arguments that name a run, as a parent of the commands' parsers."""
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument(
        "--config", metavar="FILE", help=f"configuration of the run (default {DEFAULT_CONFIG})"
    )
    parser.add_argument("--results", metavar="DIR", help="folder of all products (default: as configured)")
    return parser


def run_config(chosen: argparse.Namespace):
    """Return the configuration of the named run; raise ``UsageError`` if it is not valid."""
    from vibraverse.config import load

    config = load(chosen.config or DEFAULT_CONFIG)
    return config.model_copy(update={"results": chosen.results}) if chosen.results else config


def run_paths(chosen: argparse.Namespace):
    """Return the paths of the named run; without a configuration here, its products are taken to be in results/."""
    from vibraverse.flow.paths import Paths

    if chosen.results or not (chosen.config or Path(DEFAULT_CONFIG).is_file()):
        return Paths(chosen.results or "results")
    return Paths(run_config(chosen).results)


def run_solidities(chosen: argparse.Namespace) -> tuple[str, ...]:
    """Return the bodies that the named run makes; both, without a configuration here."""
    from vibraverse.flow.paths import SOLIDITIES

    known = chosen.config or Path(DEFAULT_CONFIG).is_file()
    return tuple(run_config(chosen).solidities) if known else SOLIDITIES


def share(text: str) -> float:
    """Return a share between 0 and 1; the type of an argument."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= 1:
        raise argparse.ArgumentTypeError(f"a share lies between 0 and 1, not {text!r}")
    return value
