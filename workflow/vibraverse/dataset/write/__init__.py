"""From products to shards and the dataset's tables."""
