"""Shared code of the mesh readers: limits, lines of text, JSON documents, PLY rows, polygons, scenes."""
