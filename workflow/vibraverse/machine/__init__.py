"""What a run asks of its machine."""
