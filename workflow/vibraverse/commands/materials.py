"""``vibraverse materials``: print the table of known materials."""

from __future__ import annotations

import argparse

from vibraverse.physics.materials import MATERIALS

#: Parameter -> heading with unit.
_HEADINGS = {
    "density_kg_m3": "density kg/m³",
    "young_pa": "Young Pa",
    "poisson": "Poisson",
    "alpha_per_s": "alpha 1/s",
    "beta_s": "beta s",
}


def main(argv: list[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="vibraverse materials",
        description="List the materials a configuration may name. Your own need all five numbers.",
    )
    parser.parse_args(argv)
    rows = [["material", *_HEADINGS.values()]]
    rows += [[name, *(f"{values[key]:.4g}" for key in _HEADINGS)] for name, values in MATERIALS.items()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, *numbers in rows:
        cells = (number.rjust(width) for number, width in zip(numbers, widths[1:], strict=True))
        print("  ".join([name.ljust(widths[0]), *cells]))
    return 0
