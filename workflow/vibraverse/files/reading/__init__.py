"""What the readers of several mesh formats share: limits, lines of text, JSON documents, polygons, scenes."""
