"""What is made from what, and for which objects."""
