"""Warnings about a tetrahedral mesh, as sentences for its record.

Thin walls and flat elements stay numbers of the quality table. The estimated error of each frequency says whether they
matter (:mod:`vibraverse.physics.cautions`), and mostly they do not.
"""

from __future__ import annotations

from collections.abc import Mapping

#: Largest number of elements without a warning, in multiples of ``target_elements``. Thin walls alone need twice the
#: target, and close sheets up to four times, which costs the basis a minute. At eight times the basis takes several
#: minutes and its factors gigabytes; then it pays to simplify the surface or to leave the body out.
MAX_TIMES_TARGET = 8.0


def cautions(count: int, target: float) -> list[str]:
    """Return the warnings about ``count`` tetrahedra where ``target`` were asked for."""
    times = count / target
    if times <= MAX_TIMES_TARGET:
        return []
    return [
        f"{count} tetrahedra, {times:.1f} times tets.target_elements (at most {MAX_TIMES_TARGET:g}): sheets of the "
        "surface are too close for larger elements. Simplify the mesh, or leave this body out."
    ]


def of_wrap(table: Mapping) -> list[str]:
    """Return the warning that a body was wrapped before it was filled, if it was; ``table`` is its quality table."""
    if "wrap" not in table:
        return []
    return [
        f"nothing filled the surface as it is, so it was wrapped at {100 * table['wrap']['radius']:g} % of the "
        f"diagonal, which changed the volume by {100 * table['accuracy']['volume_change']:+.2g} % and closed narrow "
        "gaps. Mend the mesh in an editor if they matter."
    ]
