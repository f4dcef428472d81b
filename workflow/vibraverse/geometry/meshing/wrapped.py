"""A wrap of a closed surface, as the last recipe: what nobody could fill is made simpler within a bound.

It is the next, rougher rung of ``clean`` for this body alone. Gaps narrower than the wrap's radius close, thin parts
become plates, and sheets that nearly touch become one.
"""

from __future__ import annotations

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.contract.progress import report
from vibraverse.geometry import Mesh, repair, surfaces
from vibraverse.geometry.cleaning.judge import Unfit, judge
from vibraverse.geometry.cleaning.wrapping import draw_in
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.distance.deviation import deviation

#: Wrap radii and distances from the surface as shares of the diagonal, gentlest first.
WRAPS = ((0.01, 0.002), (0.02, 0.003), (0.04, 0.004))
#: Largest radius of a wrap as a share of its shell's own diagonal, for small cavities.
_MAX_RADIUS = 0.2
#: Largest distance of the surface from the wrapped body, as a share of the diagonal, and the largest share of the
#: wrapped area that lies farther from the surface than that.
_MAX_LOST, _MAX_INVENTED = 0.01, 0.1


def wrapped(vertices: np.ndarray, faces: np.ndarray, radius: float, offset: float, max_change: float) -> Mesh:
    """Return a closed surface (V, 3), (F, 3) with every shell wrapped, outermost and cavities alike.

    ``radius`` and ``offset`` are shares of the diagonal, ``max_change`` is the largest relative change of the volume.
    Raises :class:`Refused` with reason ``meshing_failed`` if a wrap bounds no solid, cuts another one, or leaves the
    bounds on volume and distance.
    """
    from pymeshlab import PyMeshLabException

    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    shells = []
    for points, triangles in surfaces.components(vertices, faces):
        inward = surfaces.volume(points, triangles) < 0
        triangles = triangles[:, ::-1] if inward else triangles
        share = diagonal / float(np.linalg.norm(np.ptp(points, axis=0)))
        share = min(share, _MAX_RADIUS / radius)
        try:
            pieces = surfaces.components(*repair.wrap(points, triangles, radius * share, offset * share))
        except PyMeshLabException as error:
            raise _refused(radius, f"failed: {str(error).splitlines()[-1].strip()}") from None
        shell = max(pieces, key=lambda piece: surfaces.volume(*piece), default=None)
        if shell is None:
            raise _refused(radius, "has nothing inside")
        shell = draw_in(*shell, offset * diagonal, (points, triangles))
        try:
            judge(*shell)
        except Unfit as unfit:
            raise _refused(radius, f"does not bound a solid: {unfit}") from None
        shells.append((shell[0], shell[1][:, ::-1]) if inward else shell)
    body = surfaces.joined(shells)
    if len(shells) > 1 and crossing_faces(*body).any():
        raise _refused(radius, "makes a cavity cut the outside")
    change = surfaces.volume(*body) / surfaces.volume(vertices, faces) - 1
    if abs(change) > max_change:
        raise _refused(
            radius, f"changes the volume by {100 * change:+.2g} %, at most {100 * max_change:g} % are allowed"
        )
    away = deviation((vertices, faces), body, [])
    if away.source_to_body > _MAX_LOST or away.invented > _MAX_INVENTED:
        raise _refused(
            radius,
            f"loses parts {100 * away.source_to_body:.2g} % of the diagonal away and makes up "
            f"{100 * away.invented:.2g} % of the surface",
        )
    report(
        f"wrapped at {100 * radius:g} % of the diagonal, which changes the volume by {100 * change:+.2g} %"
    )
    return body


def _refused(radius: float, said: str) -> Refused:
    return Refused("meshing_failed", f"a wrap at {100 * radius:g} % of the diagonal {said}")
