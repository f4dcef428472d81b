"""Scale-free invariants of a body, from its closed surface: what simple predictors know of a shape.

All five are exact integrals or extremes, made dimensionless by the volume V of the material (cavities excluded). They
are invariant under rotation, mirroring, translation and scaling, and all but the last under another triangulation to
rounding. Three eigenvalues of the second moment give inertia and its ratios, the area gives the mean thickness 2V/A,
and the reach gives the size of the body beside that of its material. The sides of a principal box would say more,
but are arbitrary for equal moments: those of a square plate change by a factor of 1.4.
"""

from __future__ import annotations

import numpy as np

from vibraverse.geometry.moments import scale_free_moments, second_moments

#: The entries of :func:`invariants`: ascending eigenvalues of ``∫ x xᵀ dV`` over ``V^(5/3)``, area over ``V^(2/3)``,
#: and the largest distance from the centre of mass over ``V^(1/3)``.
INVARIANTS = ("spread_low", "spread_middle", "spread_high", "area", "reach")


def invariants(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the invariants (5,) of the body in a closed surface, cavity walls included.

    ``vertices`` (V, 3), ``faces`` (F, 3) counter-clockwise outside.
    """
    volume, centre, _ = second_moments(vertices, faces)
    reach = np.linalg.norm(vertices[np.unique(faces)] - centre, axis=1).max() / np.cbrt(volume)
    return np.append(scale_free_moments(vertices, faces), reach)


def thinness(found: np.ndarray) -> np.ndarray:
    """Return the mean thickness ``2V/A`` over the diameter ``2 reach``, (n,), from invariants (n, 5)."""
    return 1.0 / (found[:, INVARIANTS.index("area")] * found[:, INVARIANTS.index("reach")])
