"""Subcommands for people; each module has ``main(argv)``."""
