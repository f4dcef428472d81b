"""Work of the meshers, counted, and the limits on it.

Where two sheets nearly touch, every recipe asks for triangles as small as the gap, fails, and costs minutes and
gigabytes. So a recipe counts the triangles and tetrahedra that it hands to the meshers, and ends at a limit. Counts
are the same on every machine, idle or busy, so they may decide which recipe makes a mesh; seconds may not.
"""

from __future__ import annotations

#: Work of a triangle that goes into or comes out of Mmg: the unit, some 20 µs.
REMESHED = 1.0
#: Work of a remeshed triangle that is fitted to the original and tested for intersections.
FITTED = 4.0
#: Work of a tetrahedron that gmsh makes, and of one that its optimisers improve, too.
FILLED, OPTIMISED = 1.0, 4.0
#: Limits on the work of a recipe and of all recipes, per tetrahedron that a body may have.
_RECIPE_LIMIT, _TOTAL_LIMIT = 15.0, 25.0


class Spent(RuntimeError):
    """A recipe has reached its limit of work, or all recipes together have reached theirs."""


class Work:
    """The work of a body's recipes, in triangles through Mmg, and its limits for a body of ``most_elements``."""

    def __init__(self, most_elements: float = float("inf")):
        self.done = 0.0
        self._recipe, self._total = _RECIPE_LIMIT * most_elements, _TOTAL_LIMIT * most_elements
        self._until = self._recipe

    @property
    def exhausted(self) -> bool:
        """Whether all recipes together have reached their limit."""
        return self.done >= self._total

    def begin(self) -> None:
        """Begin a recipe with work of its own, as far as the total allows."""
        self._until = min(self.done + self._recipe, self._total)

    def check(self) -> None:
        """Raise :class:`Spent` if the limit has been reached; call it before a mesher begins."""
        if self.done >= self._until:
            raise Spent(f"given up after handling {self.done:.0f} triangles, because sheets are too close")

    def add(self, count: float, each: float = REMESHED) -> None:
        """Count triangles or tetrahedra that a mesher handled, with the work of ``each``."""
        self.done += each * count
