"""Options of the dataset and the report."""

from __future__ import annotations

from pydantic import Field

from vibraverse.config.base import Section


class Dataset(Section):
    """HDF5 shards, index and splits."""

    shards: int = Field(4, ge=1, le=100_000)
    """Number of HDF5 files; an object's shard is a stable hash of its id. Changing it rewrites all."""

    splits: dict[str, float] = Field(default_factory=lambda: {"train": 0.8, "validation": 0.1, "test": 0.1})
    """Share of the objects in each split; an object's split is a stable hash of its id."""

    max_refused_share: float = Field(0.5, ge=0, le=1)
    """The run fails when a larger share of the objects is refused."""


class Report(Section):
    """The page people open."""

    title: str = "VibraVerse"
    """Heading of the page."""

    max_objects: int = Field(60, ge=1)
    """Objects shown in full; the others are counted."""
