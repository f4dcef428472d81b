"""``vibraverse config``: check a configuration, show it with all defaults, print its JSON schema or its reference."""

from __future__ import annotations

import argparse

from vibraverse.cli import UsageError
from vibraverse.config import Config, ConfigError, load, schema_text
from vibraverse.config.reference import markdown


def main(argv: list[str]) -> int:
    """Run one of the actions."""
    parser = argparse.ArgumentParser(prog="vibraverse config", description="Check or show a configuration.")
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, text in (
        ("check", "say whether the configuration is valid and its files are there"),
        ("show", "print the configuration with every default filled in"),
    ):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument(
            "file", nargs="?", default="config.yaml", metavar="FILE", help="default config.yaml"
        )
    actions.add_parser("schema", help="print the JSON schema, for editors that check while you type")
    actions.add_parser("reference", help="print every key with its default and meaning (Markdown)")
    chosen = parser.parse_args(argv)

    if chosen.action in ("schema", "reference"):
        print(schema_text() if chosen.action == "schema" else markdown(), end="")
        return 0
    config = _load(chosen.file)
    if chosen.action == "show":
        print(_resolved(config))
    else:
        print(f"{chosen.file} is valid and names {_count(config)} objects.")
    return 0


def _load(path: str) -> Config:
    try:
        return load(path)
    except ConfigError as error:
        raise UsageError(str(error)) from None


def _count(config: Config) -> int:
    """Return how many objects a configuration names; looks for its files, not into them."""
    from vibraverse.sources.catalogue import catalogue

    try:
        return len(catalogue(config))
    except ConfigError as error:
        raise UsageError(str(error)) from None


def _resolved(config: Config) -> str:
    import yaml

    return yaml.safe_dump(
        config.model_dump(mode="json"), sort_keys=False, allow_unicode=True, default_flow_style=None
    ).rstrip()
