"""Baselines of the learning tasks: what a network must beat. Arrays in, arrays out."""
