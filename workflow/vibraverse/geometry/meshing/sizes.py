"""Surfaces of a body remeshed at sizes that give about the wanted number of elements.

The size is found by trial: each surface is filled once without optimising. What this costs is counted, and a search
ends where its limit of work is reached (:mod:`vibraverse.geometry.meshing.work`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.contract.progress import report
from vibraverse.geometry import Mesh, repair, surfaces
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.meshing.fill import fill
from vibraverse.geometry.meshing.remesh import EvenSurface, SheetsMeet
from vibraverse.geometry.meshing.sizing import Sizing
from vibraverse.geometry.meshing.work import FILLED, Work

#: Largest factor between element count and target, the most sizes tried, and the first exponent: the size changes by
#: this power of the factor.
_COUNT_TOLERANCE, _MAX_TRIALS, _FIRST_EXPONENT = 1.08, 5, 0.55
#: Wanted upper bound on the element size in mean thicknesses 2V/A of the body, and the largest factor by which it may
#: raise the target.
_MAX_THICKNESSES, _MAX_EXCESS = 2.0, 2.0
#: Factor on the size after sheets met, and the number of meetings at which the recipe ends. If no size has worked
#: before the last retry, that one fits the walls.
_SIZE_REDUCTION, _MAX_MEETINGS = 0.85, 3
#: An even surface made for one size serves sizes down to this share of it.
_MIN_REUSE = 0.6
#: Largest size in multiples of the first. An exponent above the second number is futile: the count comes from small
#: features, and larger triangles elsewhere would spoil the shape. The search then ends unless the count is far off.
_MAX_SIZE_GROWTH, _FUTILE_EXPONENT = 2.0, 1.0
#: A count beyond this many times the wanted one is far off.
_FAR_FACTOR = 1.5
#: Most triangles of a remeshed surface and of an even one, per tetrahedron that the body may have. A closed surface has
#: at most twice as many triangles as tetrahedra behind it, and mostly half as many.
_MAX_TRIANGLES, _MAX_EVEN_TRIANGLES = 1.0, 3.0
#: A surface with more triangles than the first number, and than the second per wanted element, is thinned before it is
#: remeshed. Thinning moves it by at most these shares of the remeshing's deviation, tried in turn until no triangles
#: cut each other. It makes creases of its own, so some bodies take more elements: it is for scans alone.
_SCANNED_TRIANGLES, _DENSE_TRIANGLES, _THINNING_SHARES = 30_000, 4.0, (0.2, 0.05)
#: Largest distance of the remeshed surface from the original, as a share of the size.
_MAX_DEVIATION = 0.07
#: Factor by which Netgen's optimiser raises the number of elements.
_OPTIMISER_GROWTH = 1.03


@dataclass(frozen=True)
class Trial:
    """A surface remeshed at one ``size``.

    ``wanted`` is the number of elements that it should hold, ``excess`` the logarithm of actual over wanted number.
    """

    size: float
    points: np.ndarray
    triangles: np.ndarray
    wanted: float
    excess: float

    @property
    def count(self) -> float:
        """The number of elements, about."""
        return self.wanted * float(np.exp(self.excess))


class TooMany(Refused):
    """A body takes more tetrahedra than it may have."""

    @classmethod
    def of(cls, count: float, most: float) -> TooMany:
        """Return the refusal of a body that takes ``count`` where ``most`` are allowed."""
        return cls("meshing_failed", f"the body takes {count:.0f} tetrahedra; at most {most:.0f} are allowed")


class Body:
    """The surface of a body, with cached values, for about ``elements`` tetrahedra and never above ``most``.

    What its recipes do is counted in ``work``.
    """

    def __init__(
        self, vertices: np.ndarray, faces: np.ndarray, elements: float, most: float, work: Work | None = None
    ):
        self.surface, self.most, self.work = (vertices, faces), most, work or Work(most)
        self.volume, self.area = surfaces.volume(vertices, faces), surfaces.area(vertices, faces)
        self.thickness = 2 * self.volume / self.area
        #: The first size tried.
        self.size = self.size_for(elements)
        self._dense = len(faces) > max(_SCANNED_TRIANGLES, _DENSE_TRIANGLES * elements)
        self._even: dict[float, EvenSurface] = {}
        #: Whether the fit may yield where sheets are close: the last resort.
        self.yielding = False

    @cached_property
    def start(self) -> Mesh:
        """The surface that remeshing starts from, without the triangles that elements of the first size cannot follow.

        The remeshed surface is fitted to the original, so its volume and its deviation do not depend on this.
        """
        for share in _THINNING_SHARES if self._dense else ():
            thinner = thinned(*self.surface, share * _MAX_DEVIATION * self.size)
            if not crossing_faces(*thinner).any():
                return thinner
        return self.surface

    def count_at(self, size: float) -> float:
        """Return the approximate number of elements of a size, in the surface layer and inside."""
        return 8 * self.area / size**2 + 8 * self.volume / size**3

    def size_for(self, count: float) -> float:
        """Return the size that gives about ``count`` elements, by bisection of :meth:`count_at`."""
        low, high = 1e-4, 2.0
        for _ in range(60):
            middle = np.sqrt(low * high)
            low, high = (middle, high) if self.count_at(middle) > count else (low, middle)
        return float(high)

    def remesh(self, size: float, ridge_deg: float) -> Mesh:
        """Return the surface remeshed with triangles of about ``size``."""
        even = self._even.get(ridge_deg)
        if even is None or size < _MIN_REUSE * even.size:
            sizing = Sizing(*self.surface, size)
            even = EvenSurface(
                *self.surface,
                size,
                sizing,
                _MAX_DEVIATION * size,
                ridge_deg,
                _MAX_EVEN_TRIANGLES * self.most,
                self.start,
                self.work,
            )
            self._even[ridge_deg] = even
        return even.remesh(size, _MAX_DEVIATION * size, self.yielding, _MAX_TRIANGLES * self.most)


def thinned(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> Mesh:
    """Return a closed surface with fewer triangles, moved by less than ``tolerance``; some may cut each other.

    The surface stays as it is where a part of it would vanish.
    """
    try:
        thinner = repair.simplify(vertices, faces, tolerance)
    except ValueError:
        return vertices, faces
    found, before = (surfaces.topology(f, len(v)) for v, f in (thinner, (vertices, faces)))
    if not found.closed_manifold or found.components != before.components:
        return vertices, faces
    report(f"thinned {len(faces)} triangles to {len(thinner[1])}")
    return thinner


def search_size(body: Body, ridge_deg: float, size: float, target: int) -> list[Trial]:
    """Remesh the surface at sizes that give about ``target`` elements, starting from ``size``; the best comes first.

    Thin walls need triangles not much larger than their thickness, which raises the target within bounds. A size at
    which sheets cut each other is too large. A still larger one is tried only if there are far too many elements.
    Sizes far above the first would change the shape more than the count. Raises :class:`SheetsMeet` if no size works,
    :class:`TooMany` if all take more elements than the body may have, and :class:`Spent` at the limit of work.
    """
    tried: list[Trial] = []
    largest, too_large, meetings = _MAX_SIZE_GROWTH * size, np.inf, 0
    for _ in range(_MAX_TRIALS):
        try:
            points, triangles = body.remesh(size, ridge_deg)
            count = _OPTIMISER_GROWTH * len(fill(points, triangles, optimise=False)[1])
            body.work.add(count, FILLED)
        except SheetsMeet as meeting:
            report(f"triangles of {size:.3g}: {meeting}")
            too_large, meetings = min(too_large, size), meetings + 1
            if meetings == _MAX_MEETINGS:
                break
            size *= _SIZE_REDUCTION
            if meetings == _MAX_MEETINGS - 1 and not tried:
                size = min(size, _MAX_THICKNESSES * body.thickness)
            continue
        except (Refused, RuntimeError):
            if tried:
                break
            raise
        thin = count * body.count_at(_MAX_THICKNESSES * body.thickness) / body.count_at(size)
        wanted = float(np.clip(thin, target, _MAX_EXCESS * target))
        tried.append(Trial(size, points, triangles, wanted, float(np.log(count / wanted))))
        report(f"triangles of {size:.3g}: some {count:.0f} tetrahedra, {wanted:.0f} wanted")
        if abs(tried[-1].excess) < np.log(_COUNT_TOLERANCE):
            break
        exponent = _exponent(tried)
        if exponent > _FUTILE_EXPONENT and 0 < tried[-1].excess < np.log(_FAR_FACTOR):
            break
        size *= float(np.clip(np.exp(exponent * tried[-1].excess), 0.5, 2.0))
        if size > largest or (size > _SIZE_REDUCTION * too_large and tried[-1].excess < np.log(_FAR_FACTOR)):
            break
    if not tried:
        raise SheetsMeet(f"sheets of the surface are closer than triangles of {too_large:.3g}")
    fewest = min(trial.count for trial in tried)
    if fewest > body.most:
        raise TooMany.of(fewest, body.most)
    return sorted((trial for trial in tried if trial.count <= body.most), key=lambda trial: abs(trial.excess))


def _exponent(tried: list[Trial]) -> float:
    """Return the power of the count's error by which the size should change: a secant step of two trials."""
    if len(tried) < 2:
        return _FIRST_EXPONENT
    first, second = tried[-2:]
    apart, step = first.excess - second.excess, float(np.log(second.size / first.size))
    return float(np.clip(step / apart, 0.25, 1.5)) if step * apart > 0 else 1.5
