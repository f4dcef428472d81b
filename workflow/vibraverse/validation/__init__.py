"""The physics held against frequencies that others measured, or that can be computed without finite elements."""
