"""Mesh formats, one module each."""
