"""What to know about a mesh before computing with it: sentences in its record.

Thin walls and flat elements are numbers of the quality table and no warnings: whether they matter the error estimated
of each frequency says (:mod:`vibraverse.physics.cautions`), and it contradicts them mostly.
"""

from __future__ import annotations

#: Up to this many times ``target_elements`` a body costs what bodies cost: thin walls get twice the target by
#: themselves, close sheets up to four times, which takes the basis a minute. At eight times it takes several, and its
#: factors gigabytes: then a simpler surface, or leaving the body out, is worth somebody's while.
MAX_TIMES_TARGET = 8.0


def cautions(count: int, target: float) -> list[str]:
    """Return the warnings about ``count`` tetrahedra where ``target`` were asked for; mostly none."""
    times = count / target
    if times <= MAX_TIMES_TARGET:
        return []
    return [
        f"{count} tetrahedra, {times:.1f} times tets.target_elements (at most {MAX_TIMES_TARGET:g}): sheets of the "
        "surface are too close for larger elements. Simplify the mesh, or leave this body out."
    ]
