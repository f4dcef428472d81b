"""Checks that a dataset is complete, unchanged and consistent."""
