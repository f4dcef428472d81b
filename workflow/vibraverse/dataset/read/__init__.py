"""Reading a dataset."""
