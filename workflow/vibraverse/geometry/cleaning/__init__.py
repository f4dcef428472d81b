"""Mesh cleaning: from a triangle soup to the surface of one solid body."""
