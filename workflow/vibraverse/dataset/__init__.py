"""Record schema, shards, splits and readers."""
