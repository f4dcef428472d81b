"""The split of every object."""
