"""Readers of a dataset."""
