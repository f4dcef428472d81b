"""The page people open."""
