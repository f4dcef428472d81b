"""Open-ended family of bars that are tapered, twisted and bent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from vibraverse.geometry.profiles import extrude
from vibraverse.sources.families import warps
from vibraverse.sources.families.outlines import section
from vibraverse.sources.families.redraw import OpenShape, fine, warped
from vibraverse.sources.families.shape import between, one_of
from vibraverse.sources.families.solids import arrays, solid

#: The inside of a bend keeps 0.3 of its radius; no bar bends by more than this many radians.
_MOST_BENT, _MOST_TURN = 0.7, 4.4


@dataclass(frozen=True)
class Bent(OpenShape):
    """A bar of random section, tapered, twisted and bent."""

    size_range_m = (0.05, 0.4)
    slender: float = between(-0.5, 2.1)
    tapered: bool = one_of(False, True)
    twisted: bool = one_of(False, True)

    def body(self, random: np.random.Generator) -> Manifold:
        """Extrude a section to ``2 ** slender`` of its width, and warp it; what is not twisted is always bent."""
        length = float(np.exp2(self.slender))
        bar = fine(solid(extrude(section(random), length, 0.06 * max(1.0, length))))
        end, curve = random.uniform(0.35, 0.85), random.uniform(0.6, 2.0)
        turns = random.uniform(0.1, 0.35) * random.choice([-1, 1]) * max(1.0, length)
        bent = not self.twisted or random.random() < 0.6
        heading, share = random.uniform(0, 2 * np.pi), random.uniform(0.3, 1.0)

        def warp(points: np.ndarray) -> np.ndarray:
            if self.tapered:
                points = warps.taper(points, end, curve)
            if self.twisted:
                points = warps.twist(points, turns)
            if not bent:
                return points
            points = warps.turn(points, heading)
            return warps.bend(points, min(_MOST_TURN, warps.most_bend(points, _MOST_BENT)) * share)

        return warped(arrays(bar), warp)
