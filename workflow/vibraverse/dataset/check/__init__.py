"""Whether a dataset is whole and agrees with itself."""
