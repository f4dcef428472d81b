"""Bodies with known frequencies, and the resolution of their meshes.

This module holds plain numbers, so rules can list the bodies without loading a library.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Body:
    """A body of one material, its meshes, and the tolerances of its frequencies.

    ``lengths_m`` is the radius of a ball, the sides of a box, or radius and height of a cylinder. ``wall`` hollows the
    body as the stage ``hollow`` does: the wall is that share of the depth of the deepest point. ``elements`` are the
    target numbers of tetrahedra for both orders, ``finer`` those for order 1 alone. ``tolerances`` bound the relative
    error of every frequency on the finest mesh, by order: first uncorrected, then corrected. They are about twice the
    measured errors. An order without tolerances is shown, not judged.
    """

    name: str
    title: str
    kind: Literal["ball", "box", "cylinder"]
    lengths_m: tuple[float, ...]
    tolerances: dict[int, tuple[float, float]]
    young_pa: float = 2.0e11
    density_kg_m3: float = 8000.0
    poissons: tuple[float, ...] = (0.3,)
    wall: float = 0.0
    elements: tuple[int, ...] = (300, 1000, 3000)
    finer: tuple[int, ...] = (9000,)
    modes: int = field(default=30)
    """Number of frequencies compared; balls compare all multiplets up to ``limit``, in ω a / c_s."""
    limit: float = 0.0

    def material(self, poisson: float) -> dict:
        """Return the undamped material for :func:`vibraverse.physics.modes.solve_material`."""
        return {
            "young_pa": self.young_pa,
            "density_kg_m3": self.density_kg_m3,
            "poisson": poisson,
            "alpha_per_s": 0.0,
            "beta_s": 0.0,
        }


#: The aluminium of the measured block: C11 = 109.26 GPa, C44 = 26.72 GPa.
_MU = 26.72e9
_POISSON = (109.26e9 - 2 * _MU) / (2 * (109.26e9 - _MU))

BODIES: dict[str, Body] = {
    body.name: body
    for body in (
        Body(
            "ball",
            "Ball",
            "ball",
            (0.1,),
            {1: (0.12, 0.016), 2: (0.004, 0.0003)},
            poissons=(0.20, 0.25, 0.30, 0.35),
            limit=5.8,
        ),
        Body(
            "hollow-ball",
            "Hollow ball",
            "ball",
            (0.1,),
            {1: (0.24, 0.04), 2: (0.03, 0.007)},
            wall=0.4,
            limit=5.1,
        ),
        Body("cube", "Cube", "box", (0.1, 0.1, 0.1), {1: (0.13, 0.012), 2: (0.0016, 0.0001)}),
        Body(
            "block",
            "Aluminium block",
            "box",
            (11.92e-3, 10.93e-3, 9.86e-3),
            {1: (0.1, 0.006), 2: (0.002, 0.0002)},
            young_pa=2 * _MU * (1 + _POISSON),
            density_kg_m3=2788.0,
            poissons=(_POISSON,),
            modes=12,
        ),
        Body("cylinder", "Cylinder", "cylinder", (0.05, 0.13), {1: (0.15, 0.012), 2: (0.004, 0.0002)}),
        Body("bar", "Bar", "box", (1.0, 0.05, 0.05), {1: (0.25, 0.012), 2: (0.01, 0.0013)}, modes=10),
        Body(
            "plate",
            "Plate",
            "box",
            (10.0, 10.0, 0.05),
            {2: (0.016, 0.007)},
            elements=(1000, 2000, 5000),
            finer=(),
            modes=6,
        ),
    )
}
