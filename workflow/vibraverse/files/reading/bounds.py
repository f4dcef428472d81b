"""Limits on the contents of a mesh file, enforced during reading, so that no header can exhaust the memory."""

from __future__ import annotations

from dataclasses import dataclass

#: Largest file that is read, in bytes.
MAX_BYTES = 1 << 30

#: Most parts of a scene, counted once per placement.
MAX_PARTS = 100_000


class TooLarge(Exception):
    """A file holds or announces more than the limits allow; the message completes "the file …"."""


@dataclass(frozen=True)
class Bounds:
    """Limit on the triangles of a mesh, and so on its vertices: at most three per triangle."""

    max_triangles: int

    @property
    def max_vertices(self) -> int:
        """Largest number of vertices, unused ones included."""
        return 3 * self.max_triangles + 1000

    def check(self, vertices: int = 0, triangles: int = 0) -> None:
        """Raise :class:`TooLarge` if a number of vertices or triangles exceeds its limit."""
        if triangles > self.max_triangles:
            raise TooLarge(f"has {triangles} triangles; the limit is {self.max_triangles}")
        if vertices > self.max_vertices:
            raise TooLarge(
                f"has {vertices} vertices; the limit is {self.max_vertices}, "
                f"which {self.max_triangles} triangles cannot exceed"
            )
