"""What one should know about a mesh before trusting it: sentences in its record, and the kinds they are counted by."""

from __future__ import annotations

#: Below this many elements from one side to the other a wall counts as thin.
THIN = 2.0
#: An element count this many times the target is worth a warning.
FAR_OFF = 1.5
#: This share of the surface may bound thin walls.
_THIN_SHARE = 0.1

_THIN_WALLS = "of the surface bounds walls thinner than"
_MANY_ELEMENTS = "sheets too close for larger triangles need them"
_SLIVERS = "tetrahedra have an angle below"

#: Kinds of warnings and the sentence a summary shows for each.
KINDS = {
    "thin_walls": "walls with fewer than two elements across",
    "many_elements": "far more elements than asked for",
    "slivers": "some tetrahedra are nearly flat",
    "other": "what else the mesh's record says",
}
_TOLD_BY = {"thin_walls": _THIN_WALLS, "many_elements": _MANY_ELEMENTS, "slivers": _SLIVERS}


def cautions(table: dict, count: int, target: float) -> list[str]:
    """Return sentences about what makes a mesh less trustworthy or dearer than asked, from its quality table."""
    found = []
    if table["layers"]["thin_share"] > _THIN_SHARE:
        found.append(
            f"{100 * table['layers']['thin_share']:.0f} % {_THIN_WALLS} {THIN:g} elements "
            f"(half of them below {table['layers']['median']:.2g}): raise tets.target_elements where bending matters."
        )
    if count > FAR_OFF * target:
        found.append(f"{count} tetrahedra instead of {target:.0f}: {_MANY_ELEMENTS}.")
    if table["slivers"]:
        found.append(f"{table['slivers']} {_SLIVERS} 5 degrees between two faces.")
    return found


def kind_of(sentence: str) -> str:
    """Return the kind of a warning, a key of :data:`KINDS`; records hold the sentences alone."""
    return next((kind for kind, words in _TOLD_BY.items() if words in sentence), "other")
