"""Writers of shards and of the dataset's tables, from products."""
