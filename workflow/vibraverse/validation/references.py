"""Reference frequencies of each body with their source: computed without finite elements, measured, or published."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vibraverse.physics.materials import lame
from vibraverse.validation import spectra
from vibraverse.validation.bodies import Body

#: Relative tolerance within which frequencies belong to one multiplet.
_MULTIPLET_TOLERANCE = 1e-6
#: Polynomial degrees by axis. Higher ones change the frequencies of the compact bodies and of the bar by at most 2e-5,
#: those of the plate by at most 3e-4.
_DEGREES = {
    "cube": (14,) * 3,
    "block": (14,) * 3,
    "cylinder": (14,) * 3,
    "bar": (28, 10, 10),
    "plate": (28, 28, 4),
}
_LAMB = "characteristic equation (Lamb 1881; Eringen and Şuhubi 1975)"
_RITZ = "Ritz's method with polynomials (Demarest 1971; Visscher et al. 1991)"


@dataclass(frozen=True)
class Published:
    """Frequencies from the literature in Hz, ascending from the first, with their relative tolerance."""

    source: str
    hz: tuple[float, ...]
    tolerance: float


#: The block was measured by resonant ultrasound. NAFEMS gives thin-plate theory, which is up to 1.2 % too high.
PUBLISHED = {
    "block": Published(
        "measured: Ogi et al., J. Acoust. Soc. Am. 112, 2553 (2002)",
        (
            116716.0, 143783.0, 158081.0, 166500.0, 169523.0, 177846.0,
            183875.0, 186047.0, 190341.0, 197386.0, 201133.0, 207386.0,
        ),
        0.006,
    ),
    "plate": Published(
        "NAFEMS, Selected Benchmarks for Natural Frequency Analysis, FV12",
        (1.622, 2.360, 2.922, 4.233, 4.233, 7.416),
        0.015,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Reference:
    """A reference frequency of a body: ``count`` equal ones from number ``first`` on (0 is the lowest elastic one).

    ``tolerance`` is the relative error accepted for order 2 on the finest mesh; None means that of the body. Published
    frequencies are only as good as their source, so they are compared with elements of order 2 alone.
    """

    mode: str
    poisson: float
    first: int
    count: int
    hz: float
    source: str
    published: bool = False
    tolerance: float | None = None


def references(body: Body, poisson: float) -> list[Reference]:
    """Return the reference frequencies of a body: all computed ones, ascending, then the published ones."""
    lines = _multiplets(body, poisson) if body.kind == "ball" else _ritz(body, poisson)
    known = PUBLISHED.get(body.name)
    if known:
        lines += [
            Reference(f"{first + 1} published", poisson, first, 1, hz, known.source, True, known.tolerance)
            for first, hz in enumerate(known.hz)
        ]
    return lines


def _multiplets(body: Body, poisson: float) -> list[Reference]:
    (radius,) = body.lengths_m
    unit_hz = np.sqrt(lame(body.young_pa, poisson)[1] / body.density_kg_m3) / (2 * np.pi * radius)
    found, first = [], 0
    for name, eta in spectra.spherical(poisson, body.limit, 1 - body.wall if body.wall else 0.0).items():
        count = 2 * int(name[1:].rstrip("'")) + 1
        found.append(Reference(name, poisson, first, count, float(eta * unit_hz), _LAMB))
        first += count
    return found


def _ritz(body: Body, poisson: float) -> list[Reference]:
    degrees = _DEGREES[body.name]
    if body.kind == "cylinder":
        omega = spectra.cylinder(*body.lengths_m, degrees[0], poisson, body.modes)
    else:
        omega = spectra.box(body.lengths_m, degrees, poisson, body.modes)
    hz = omega * np.sqrt(body.young_pa / body.density_kg_m3) / (2 * np.pi)
    starts = [0, *(np.flatnonzero(np.diff(hz) > _MULTIPLET_TOLERANCE * hz[1:]) + 1), len(hz)]
    return [
        Reference(_numbers(a, b), poisson, int(a), int(b - a), float(hz[a:b].mean()), _RITZ)
        for a, b in pairwise(starts)
    ]


def _numbers(start: int, stop: int) -> str:
    return f"{start + 1}" if stop - start == 1 else f"{start + 1} to {stop}"
