"""Cleaning, grids, hollowing and tetrahedra: arrays in, arrays out, no file paths."""
