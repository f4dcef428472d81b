"""Options of the dataset and the report."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from vibraverse.config.base import Section


def _shares_add_up(splits: dict[str, float]) -> dict[str, float]:
    for name, share in splits.items():
        if not name.replace("-", "").replace("_", "").isalnum():
            raise ValueError(f"the split name {name!r} may hold only letters, digits, '-' and '_'")
        if share < 0:
            raise ValueError(f"the share of {name!r} must not be negative, not {share:g}")
    if abs(sum(splits.values()) - 1.0) > 1e-6:
        raise ValueError(f"the shares must add up to 1, not {sum(splits.values()):g}")
    return splits


class Card(Section):
    """What the dataset card states; the rest is counted."""

    name: str = Field("VibraVerse dataset", min_length=1)
    """Name of the dataset."""

    description: str = "Shapes, materials, vibration modes, impact sounds and pictures that agree by physics."
    """Description in one or two sentences."""

    creators: list[str] = Field(default_factory=lambda: ["VibraVerse"], min_length=1)
    """Names of the creators."""

    version: str = "1.0.0"
    """Version of the dataset."""

    url: str | None = None
    """Address of the dataset; set it before publishing."""

    published: str | None = Field(None, pattern=r"^\d{4}-\d{2}-\d{2}$")
    """Date of publication, YYYY-MM-DD; set it before publishing, because no stage reads the clock."""

    licence: str | None = None
    """Licence of the whole dataset. Default: the licences of the sources are listed."""


class Dataset(Section):
    """HDF5 shards, index and splits."""

    shards: int = Field(4, ge=1, le=100_000)
    """Number of HDF5 files; an object's shard is a stable hash of its id. A change rewrites all shards."""

    splits: dict[str, float] = Field(default_factory=lambda: {"train": 0.8, "validation": 0.1, "test": 0.1})
    """Share of the objects in each split; an object's split is a stable hash of its id, or that of its original."""

    stratify: Literal["none", "origin", "category"] = "none"
    """Whether each origin, or each category, is divided in these shares too. Then a growing dataset moves a few objects
    to another split."""

    keep_splits: str | None = None
    """A ``splits.tsv`` of an earlier dataset, whose objects keep their splits, whatever else changes."""

    card: Card = Card()
    """Statements about the dataset in its card and its Croissant metadata."""

    max_refused_share: float = Field(0.5, ge=0, le=1)
    """The run fails when a larger share of the objects is refused."""

    @field_validator("splits")
    @classmethod
    def _valid_splits(cls, splits):
        return _shares_add_up(splits)


class ShardOptions(Section):
    """Contents of one shard, which the workflow fills in from the rest of the configuration."""

    results: str = Field("results", exclude=True)
    """Folder of all products. The bytes of a shard do not depend on it, so its record omits it."""

    objects: list[str] = Field(default_factory=list, exclude=True)
    """Ids of the objects in the shard, which are also the names of its groups."""

    materials: list[str] = Field(min_length=1)
    """Materials to pack."""

    solidities: list[str] = Field(default_factory=lambda: ["solid", "hollow"], min_length=1)
    """Bodies to pack."""

    looks: list[str] = Field(default_factory=list)
    """Looks of the pictures to pack."""


class IndexOptions(Section):
    """Options of the index: the splits and the card."""

    splits: dict[str, float] = Field(default_factory=lambda: Dataset().splits)
    """Share of the objects in each split."""

    stratify: Literal["none", "origin", "category"] = "none"
    """Column of the index; the objects of each of its values are divided in these shares."""

    card: Card = Card()
    """Statements about the dataset in its card."""

    @field_validator("splits")
    @classmethod
    def _valid_splits(cls, splits):
        return _shares_add_up(splits)


class Report(Section):
    """The report: a web page."""

    title: str = "VibraVerse"
    """Heading of the page."""

    kind: Literal["run", "dataset"] = "run"
    """``run`` opens on what happened, with refusals, times and the command that retries. ``dataset`` is for publishing:
    it opens on the objects, says licence, citation and how to load them, and names no folder of this machine."""


class ReportOptions(Report):
    """Options of the page, which the workflow completes from the rest of the configuration."""

    results: str = Field("results", exclude=True)
    """Folder of all products, for the times of the jobs. The page does not name it."""

    card: Card = Card()
    """Statements about the dataset, as in its card."""
