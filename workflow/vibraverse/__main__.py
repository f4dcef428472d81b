"""Allow ``python -m vibraverse``."""

from vibraverse.cli import entry

entry()
