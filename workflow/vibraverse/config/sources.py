"""Options of the sources of objects."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, NonNegativeInt

from vibraverse.config.base import Section, Size


class Generated(Section):
    """Objects drawn from the shape families."""

    count: NonNegativeInt = 8
    """Number of objects; families take turns in the order listed."""

    families: list[str] | Literal["parametric", "open-ended", "all"] = "parametric"
    """Family names, or a word: ``parametric``, ``open-ended`` or ``all``. A list may hold both."""

    first: NonNegativeInt = 0
    """Number of the first object of each family; another number gives a set without common objects."""

    cavities: int = Field(1, ge=1, le=100)
    """Objects of every shape. They are the same but for the thickness of their hollow body's wall, so only sound can
    tell them apart; ``_2``, ``_3``, … at the end of the id count them."""


class Files(Section):
    """Mesh files: a folder, a glob, or a manifest that lists them."""

    path: str
    """A file, a folder (searched with its subfolders), a glob, or a manifest: a ``.csv`` or ``.tsv`` that lists one
    mesh per row. ``docs/own-meshes.md`` lists the formats."""

    size_m: Size | None = None
    """Longest side of every mesh in metres, 0.001 to 50, unless its row states one. Default: the size that the file
    states, else ``sources.default_size_m``."""

    category: str | None = None
    """Category of these files, unless a row states one; kept in every record."""

    categories: list[str] = Field(default_factory=list)
    """Valid categories for ``category`` and for the rows of a manifest. Empty: any."""

    licence: str = "unknown"
    """Licence of these files, unless a row states one; kept in every record."""


class Objaverse(Section):
    """Objects of Objaverse, fetched by UID into a cache."""

    uids: list[str] = Field(default_factory=list)
    """Objaverse UIDs."""

    cache: str = "~/.objaverse"
    """Folder of the cache; cached models need no network."""


class Sources(Section):
    """Sources of the objects."""

    generated: Generated = Generated()
    """Parametric shapes, which need no files and no network."""

    bundled: list[str] = Field(default_factory=lambda: ["nut", "airplane", "ant"])
    """Models that ship inside the pyvista package: nut, airplane, ant."""

    files: list[Files] = Field(default_factory=list)
    """Your own meshes."""

    objaverse: Objaverse = Objaverse()
    """Objaverse models."""

    default_size_m: Size = 0.15
    """Longest side in metres of an object whose source states no size."""

    sizes_m: dict[str, Size] = Field(default_factory=dict)
    """Longest side in metres by object id, with priority over every other size. A change reruns only ``modes`` and the
    stages that depend on it."""


class SourceEntry(Section):
    """Options of the stage ``sources`` for one object."""

    origin: Literal["generated", "bundled", "files", "objaverse"] = "generated"
    """Kind of source; ``generated`` and ``bundled`` objects are found by their id, ``files`` by the input."""

    category: str | None = None
    """Category of a mesh of your own."""

    licence: str = "unknown"
    """Licence of a mesh of your own."""

    uid: str | None = None
    """Objaverse UID."""

    cache: str = Field("~/.objaverse", exclude=True)
    """Folder of the Objaverse cache; objects do not depend on it, so records omit it."""
