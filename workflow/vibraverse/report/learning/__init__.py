"""The page of learning: tables, curves, errors, and sounds to compare."""
