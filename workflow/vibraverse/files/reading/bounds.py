"""Limits on what a mesh file may hold, kept while it is read: nothing is allocated because a header says so."""

from __future__ import annotations

from dataclasses import dataclass

#: Files longer than this are not read.
MAX_BYTES = 1 << 30

#: Parts of a scene, counted as often as they are placed.
MAX_PARTS = 100_000


class TooLarge(Exception):
    """A file holds or announces more than the limits allow; the message completes "the file …"."""


@dataclass(frozen=True)
class Bounds:
    """How many triangles a mesh may have; and so how many vertices: three for each, the most that they can use."""

    max_triangles: int

    @property
    def max_vertices(self) -> int:
        """The largest number of vertices, unused ones included."""
        return 3 * self.max_triangles + 1000

    def check(self, vertices: int = 0, triangles: int = 0) -> None:
        """Raise :class:`TooLarge` if this many vertices or triangles are too many."""
        if triangles > self.max_triangles:
            raise TooLarge(f"has {triangles} triangles; the limit is {self.max_triangles}")
        if vertices > self.max_vertices:
            raise TooLarge(
                f"has {vertices} vertices; the limit is {self.max_vertices}, "
                f"which {self.max_triangles} triangles cannot exceed"
            )
