"""Which objects there are."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeInt

from vibraverse.config.base import Section, Size


class Generated(Section):
    """Objects drawn from the parametric shape families."""

    count: NonNegativeInt = 8
    """How many objects; families take turns in the order listed."""

    families: list[str] | Literal["all"] = "all"
    """Family names, or ``all``."""

    first: NonNegativeInt = 0
    """Number of the first object of each family, to draw a set that shares none with another."""


class Files(Section):
    """Mesh files: a folder, a glob, or a manifest that lists them."""

    path: str
    """A file, a folder (searched with its subfolders), a glob, or a manifest: a ``.csv`` or ``.tsv`` that lists one
    mesh per row. ``docs/own-meshes.md`` lists the formats."""

    size_m: Size | None = None
    """Longest side of every mesh in metres, 0.001 to 50, unless its row states one; without it files that
    state a size keep it and others get ``sources.default_size_m``."""

    category: str | None = None
    """What kind of thing these files show, unless a row says it; kept in every record."""

    categories: list[str] = Field(default_factory=list)
    """The categories there are: a manifest's row, or ``category``, that says another one is a mistake. Empty: any."""

    licence: str = "unknown"
    """Licence that holds for these files, unless a row states one; kept in every record."""


class Objaverse(Section):
    """Objects of Objaverse, fetched by UID into a cache."""

    uids: list[str] = Field(default_factory=list)
    """Objaverse UIDs."""

    cache: str = "~/.objaverse"
    """Folder of the cache; what is in it is used without a network."""


class Sources(Section):
    """Where the objects come from."""

    generated: Generated = Generated()
    """Parametric shapes; need no files and no network."""

    bundled: list[str] = Field(default_factory=lambda: ["nut", "airplane", "ant"])
    """Models that ship inside the pyvista package: nut, airplane, ant."""

    files: list[Files] = Field(default_factory=list)
    """Your own meshes."""

    objaverse: Objaverse = Objaverse()
    """Objaverse models."""

    default_size_m: Size = 0.15
    """Longest side in metres of an object whose source states no size."""

    sizes_m: dict[str, Size] = Field(default_factory=dict)
    """Longest side in metres by object id, overriding every other statement. Changing a size reruns only
    ``modes`` and what reads it."""


class SourceEntry(Section):
    """Where one object comes from: the options of the stage ``sources``."""

    origin: Literal["generated", "bundled", "files", "objaverse"] = "generated"
    """``generated`` and ``bundled`` objects are named by their id, ``files`` by the input."""

    category: str | None = None
    """What kind of thing a mesh of your own shows."""

    licence: str = "unknown"
    """Licence of a mesh of your own."""

    uid: str | None = None
    """Objaverse UID."""

    cache: str = Field("~/.objaverse", exclude=True)
    """Folder of the Objaverse cache; it is no part of what an object is, so no record names it."""
