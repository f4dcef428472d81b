"""``vibraverse objects``: list the objects of a configuration, or the shape families."""

from __future__ import annotations

import argparse

from vibraverse.commands import run_arguments, run_config
from vibraverse.files.formats import of_file
from vibraverse.sources.bundled import BUNDLED
from vibraverse.sources.catalogue import Entry, catalogue
from vibraverse.sources.families import FAMILIES, drawn


def main(argv: list[str]) -> int:
    """Print one line per object (id, origin, longest side, file) or per family."""
    parser = argparse.ArgumentParser(
        prog="vibraverse objects",
        parents=[run_arguments()],
        description="List the objects a configuration names, or the shape families.",
    )
    parser.add_argument("--families", action="store_true", help="list the shape families instead")
    chosen = parser.parse_args(argv)
    if chosen.families:
        _print_table([(name, family.category, family.description) for name, family in FAMILIES.items()])
        return 0
    config = run_config(chosen)
    entries = catalogue(config)
    if not entries:
        print("The configuration names no objects.")
        return 0
    rows = [("object", "origin", "longest side", "from")]
    for entry in entries.values():
        size = _size(entry, config.sources.default_size_m)
        rows.append((entry.object, entry.origin, size, str(entry.input or "")))
    _print_table(rows)
    return 0


def _size(entry: Entry, default_m: float) -> str:
    """Return the longest side that the configuration, the family, the bundle or the file states, else the default."""
    size_m = entry.size_m
    if size_m is None and entry.origin == "generated":
        size_m = drawn(entry.object).size_m
    if size_m is None and entry.origin == "bundled":
        size_m = BUNDLED[entry.object].size_m
    if size_m is not None:
        return f"{size_m:.4g} m"
    format = of_file(entry.input) if entry.input else None
    if format and format.unit_m:
        return "as in the file"
    return f"{default_m:.4g} m (default)"


def _print_table(rows: list[tuple[str, ...]]) -> None:
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        print("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())
