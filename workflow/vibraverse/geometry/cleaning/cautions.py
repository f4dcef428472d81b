"""Warnings about a cleaned surface that differs from its mesh."""

from __future__ import annotations

#: Share of a surface that may be invented, that is, lie farther from the mesh than 1 % of the diagonal. Holes of a scan
#: and the offset of a wrap stay below it. Above it the shape is a different one, and so are its frequencies.
MAX_INVENTED = 0.02
#: Share of the volume that may be dropped with separate bodies; more than this is a part, not a crumb.
MAX_DROPPED = 0.01
#: Share of the area of open and flat parts that may be left out; a few stray triangles stay below it.
MAX_LEFT_OUT = 0.05


def cautions(record: dict) -> list[str]:
    """Return the warnings about a surface, from the content of ``clean.json``."""
    found = list(record.get("warnings", []))
    invented, dropped = record["deviation"]["invented"], record["dropped"]
    left_out, joined = record.get("left_out"), record.get("joined")
    if invented > MAX_INVENTED:
        found.append(
            f"{100 * invented:.1f} % of the surface is made up (at most {100 * MAX_INVENTED:g} %): "
            f"{', '.join(record['repairs'])}. Close the mesh's holes and join its parts in a mesh editor."
        )
    if dropped["volume_share"] > MAX_DROPPED:
        found.append(
            f"{100 * dropped['volume_share']:.1f} % of the volume is left out (at most {100 * MAX_DROPPED:g} %): it "
            "lies apart from the largest body. Join the parts, or give each a file of its own."
        )
    if left_out and left_out["area_share"] > MAX_LEFT_OUT:
        found.append(
            f"{100 * left_out['area_share']:.0f} % of the area is left out (at most {100 * MAX_LEFT_OUT:g} %): it "
            "belongs to parts that enclose nothing. Give them a thickness if they are part of the body."
        )
    if joined and joined["bodies"]:
        found.append(
            f"{joined['bodies']} bodies that lie apart were joined and ring as one, which changed their volume by "
            f"{100 * joined['volume_growth']:+.1f} %. Join them in a mesh editor, or give each a file of its own."
        )
    return found
