"""What a dataset shows to others."""
