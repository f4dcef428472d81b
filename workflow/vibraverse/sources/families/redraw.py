"""Open-ended families: bodies of any number of parts, drawn again until one is sound.

A parametric family has a few named parameters. An open-ended family has a few as well, and one number more. This
number, its ``arrangement``, seeds everything else: which parts there are and where. Draw ``k`` of an object is seeded
by the arrangement and ``k`` alone, so an object stays the same for ever.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from manifold3d import Manifold

from vibraverse.contract.errors import Refused
from vibraverse.contract.seeds import rng
from vibraverse.geometry import Mesh
from vibraverse.sources.families.shape import Shape, between, in_metres
from vibraverse.sources.families.solids import arrays, remeshed, solid
from vibraverse.sources.families.soundness import WALL, flaw, too_close

#: Draws of one object. 210 objects took 1.4 on average and 11 at most.
MAX_DRAWS = 100
#: Triangles to aim for. Small triangles where a surface bends come on top.
TRIANGLES = 3500
#: Longest edge, in longest sides of the body, and in least walls where a coarse look at walls suffices.
_MAX_SPACING, _COARSE_WALLS = 0.05, 0.6
#: Longest edge before Mmg, in edges after it, and the farthest that Mmg may move the surface, in longest sides.
_BEFORE, _MOST_ASTRAY = 1.5, 0.006
#: A body keeps its largest piece if that holds this share of the volume; otherwise it is drawn again.
_MAIN_PIECE = 0.9


@dataclass(frozen=True)
class OpenShape(Shape):
    """Base of the open-ended families."""

    arrangement: int = between(0, 2**53 - 1)

    #: Angle in degrees above which an edge of the drawn solid stays sharp.
    ridge_deg: ClassVar[float] = 30.0

    def body(self, random: np.random.Generator) -> Manifold | None:
        """Draw a solid of any size, or None if the draw fails."""
        raise NotImplementedError

    def build(self) -> Mesh:
        """Return the surface of the first sound body; its longest side is about 1."""
        for k in range(MAX_DRAWS):
            body = self.body(rng(str(self.arrangement), type(self).__name__, str(k)))
            surface = finished(body, self.ridge_deg, self.size_m) if body is not None else None
            if surface is not None:
                return surface
        raise Refused(
            "unavailable",
            f"None of {MAX_DRAWS} draws of a {type(self).__name__.lower()} gives a sound body.",
            "Take an object with another number: set sources.generated.first.",
        )


def finished(body: Manifold, ridge_deg: float, size_m: float) -> Mesh | None:
    """Return the even surface of a solid, its longest side 1, or None if the body of size ``size_m`` is not sound."""
    body = main_piece(body)
    if body is None:
        return None
    if coarsely_too_close(body, WALL):
        return None
    body = to_unit(body)
    edge = spacing(body)
    # On long facets Mmg's curved patches overshoot and leave grooves.
    surface = remeshed(body.refine_to_length(_BEFORE * edge), edge, ridge_deg)
    if surface is None or strays(surface[0], body):
        return None
    # Judged as it will be stored: rounding can make triangles touch.
    return surface if flaw(in_metres(surface[0], size_m), surface[1]) is None else None


def strays(points: np.ndarray, body: Manifold) -> bool:
    """Return whether any point (N, 3) of a remeshed surface is farther from the solid's own than remeshing may be."""
    from vibraverse.geometry.distance.closest import ClosestPoint

    return bool(ClosestPoint(*arrays(body)).distance(points).max() > _MOST_ASTRAY)


def coarsely_too_close(body: Manifold, wall: float) -> bool:
    """Return whether a solid has walls thinner than ``wall`` longest sides, by a look at triangles as they are."""
    return too_close(*arrays(to_unit(body).refine_to_length(_COARSE_WALLS * wall)), wall)


def main_piece(body: Manifold) -> Manifold | None:
    """Return the largest piece of a solid without its cavities, or None if there is much else."""
    if body.is_empty():
        return None
    largest = max(body.decompose(), key=lambda piece: piece.volume())
    return largest if largest.volume() > _MAIN_PIECE * body.volume() else None


def to_unit(body: Manifold) -> Manifold:
    """Scale a solid to longest side 1, centred at the origin."""
    low, high = np.reshape(body.bounding_box(), (2, 3))
    return body.translate(list(-(low + high) / 2)).scale([1.0 / float((high - low).max())] * 3)


def spacing(body: Manifold) -> float:
    """Return the length of edges that gives a solid of longest side 1 about :data:`TRIANGLES` triangles."""
    return min(_MAX_SPACING, float(np.sqrt(body.surface_area() / (np.sqrt(3) / 4 * TRIANGLES))))


def warped(surface: Mesh, warp) -> Manifold:
    """Return the solid inside a surface whose points (N, 3) a function moves without folding."""
    return solid((warp(surface[0]), surface[1]))


def fine(body: Manifold, share: float = 0.03) -> Manifold:
    """Split the edges of a solid to a share of its longest side, so that it can be bent."""
    low, high = np.reshape(body.bounding_box(), (2, 3))
    return body.refine_to_length(share * float((high - low).max()))
