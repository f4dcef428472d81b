"""Tetrahedra within an envelope around a surface, by fTetWild: slower, but it fills what the recipes cannot.

fTetWild (Hu et al., ACM Trans. Graph. 39, 117, 2020) keeps the surface only within a distance, so sheets may be as
close and triangles as bad as they like. Its surface lies inside where the body is convex. The fit of
:mod:`vibraverse.geometry.meshing.remesh` then moves it half inside, half outside, and restores the volume.
"""

from __future__ import annotations

import contextlib
import tempfile

import numpy as np

from vibraverse.contract.errors import Refused
from vibraverse.geometry import Mesh, surfaces
from vibraverse.geometry.boundary import boundary
from vibraverse.geometry.distance.closest import ClosestPoint
from vibraverse.geometry.meshing import quality
from vibraverse.geometry.meshing.remesh import fit_to
from vibraverse.geometry.meshing.sizes import thinned

#: Distances of the envelope tried, as shares of the mean thickness 2V/A: the first, which leaves few elements, then the
#: second, or the third where the first takes too many.
ENVELOPE, NARROW_ENVELOPE, WIDE_ENVELOPE = 0.1, 0.03, 0.25
#: Largest distance of the envelope as a share of the diagonal; thick bodies would lose features beyond it.
_MAX_ENVELOPE = 0.004
#: fTetWild takes some 0.4 ms for each triangle of its surface. One with more triangles than the first number is
#: thinned by these shares of the envelope in turn until it has fewer. One that keeps more than the second is refused.
_DENSE_TRIANGLES, _MAX_TRIANGLES, _THINNING_SHARES = 5_000, 40_000, (0.1, 0.3)
#: Most rounds of its optimiser; by default it takes up to 80.
_MAX_ROUNDS = 30
#: fTetWild stops optimising at this energy of the worst element; a regular one has 3.
_ENERGY = 10.0


def fill_within(
    vertices: np.ndarray, faces: np.ndarray, size: float, envelope: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 3) and positively oriented tetrahedra (T, 4) inside a closed surface (V, 3), (F, 3).

    Elements are about ``size`` where the surface allows it, which stays within ``envelope``, or within 0.4 % of the
    diagonal if that is less. Raises :class:`Refused` with reason ``meshing_failed`` if nothing is left inside, or if
    the surface has too many triangles.
    """
    from pytetwild import tetrahedralize

    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    envelope = min(envelope, _MAX_ENVELOPE * diagonal)
    given, given_faces = _given(vertices, faces, envelope)
    # fTetWild leaves a file in the working folder.
    with tempfile.TemporaryDirectory(prefix="vibraverse-") as folder, contextlib.chdir(folder):
        points, cells = tetrahedralize(
            np.ascontiguousarray(given, dtype=np.float64),
            np.ascontiguousarray(given_faces, dtype=np.int32),
            edge_length_abs=size,
            epsilon=envelope / float(np.linalg.norm(np.ptp(given, axis=0))),
            stop_energy=_ENERGY,
            num_opt_iter=_MAX_ROUNDS,
            num_threads=1,
            quiet=True,
        )
    if not len(cells):
        raise Refused(
            "meshing_failed",
            "fTetWild found nothing inside.",
            "Repair the mesh, so that it encloses a volume.",
        )
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used], cells.reshape(-1, 4).astype(np.int64)
    turned = quality.volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [0, 1, 3, 2]]
    triangles, nodes = boundary(cells)
    closest, volume = ClosestPoint(vertices, faces), surfaces.volume(vertices, faces)
    points = points.copy()
    points[nodes] = fit_to(closest, volume, points[nodes], triangles, envelope)
    return points, cells


def _given(vertices: np.ndarray, faces: np.ndarray, envelope: float) -> Mesh:
    """Return the surface that fTetWild is given: thinned within a share of the envelope if it is dense."""
    given = vertices, faces
    for share in _THINNING_SHARES:
        if len(given[1]) > _DENSE_TRIANGLES:
            given = thinned(vertices, faces, share * envelope)
    if len(given[1]) > _MAX_TRIANGLES:
        raise Refused(
            "meshing_failed",
            f"fTetWild takes up to {_MAX_TRIANGLES} triangles, and the surface keeps {len(given[1])} within an "
            f"envelope of {envelope:.2g}.",
            "Simplify the mesh.",
        )
    return given
