"""``vibraverse config``: check a configuration, show it with all defaults, or print its JSON schema or reference."""

from __future__ import annotations

import argparse

from vibraverse.config import load, schema_text
from vibraverse.config.reference import markdown
from vibraverse.contract.texts import counted
from vibraverse.flow.plan import Plan


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
    print(_ACTIONS[chosen.action](chosen.file))
    return 0


def _checked(path: str) -> str:
    """Return the sentence that a configuration is valid; checks that its files exist, but does not read them."""
    plan = Plan(load(path))
    part = "" if plan.owned is None else f" in slice {plan.config.slice}"
    return f"{path} is valid and names {counted(len(plan.objects), 'object')}{part}."


def _resolved(path: str) -> str:
    """Return the configuration with every default filled in, as YAML."""
    import yaml

    return yaml.safe_dump(
        load(path).model_dump(mode="json"), sort_keys=False, allow_unicode=True, default_flow_style=None
    ).rstrip()


_ACTIONS = {"check": _checked, "show": _resolved}
