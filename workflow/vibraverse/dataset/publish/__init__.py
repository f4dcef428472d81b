"""Publication of a dataset: card, metadata, exports and views of several datasets."""
