"""Audio and picture rendering."""
