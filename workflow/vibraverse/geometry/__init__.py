"""Cleaning, grids, hollowing and tetrahedra: arrays in, arrays out, no file paths."""

#: Longest side of a cleaned body's bounding box, which is centred at the origin.
LONGEST_SIDE = 1.8
