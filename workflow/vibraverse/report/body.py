"""The data of a body with which the page is struck: its outside, its frequencies and shapes at every Poisson's ratio.

The largest difference between what the page computes from these data and what the workflow computes is measured here,
body by body, and goes with them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vibraverse.geometry import outside, surfaces
from vibraverse.physics.impulse import contact
from vibraverse.physics.reduced import ModalBasis
from vibraverse.physics.stops import Stops, build_stops
from vibraverse.report.packing import packed, quantised, unpacked

#: Vertices of the outside at most, about; more are decimated.
MAX_VERTICES = 1300
#: Shape columns: at least, at most, and the product with the vertices that a script has room for.
_COLUMNS, _MOST_COLUMNS, _ROOM = 72, 112, 80_000
#: Largest stored integer of columns, rotations and positions.
_COLUMN, _ROTATION, _POSITION = 1023, 2047, 32_767
#: Points at which the error is measured, and how far below the loudest band a band still counts, in decibels.
_POINTS, _FLOOR_DB = 24, 40.0


def body_data(
    basis: ModalBasis, materials: Mapping[str, Mapping], modes: int, corrected: bool, random
) -> dict:
    """Return the data of a body.

    ``materials`` are those of its modes: parameters, and ``solved_directly`` for those that the basis does not serve.
    ``modes`` and ``corrected`` are as in :func:`vibraverse.physics.modes.solve_material`. ``random`` is a NumPy
    generator for the points at which the error is measured.
    """
    served = [one["poisson"] for one in materials.values() if not one["solved_directly"]]
    true = outside.outer(basis.vertices, basis.faces)
    used, faces = np.unique(outside.decimate(basis.vertices, true, MAX_VERTICES), return_inverse=True)
    room = min(max(_ROOM // len(used), _COLUMNS), _MOST_COLUMNS)
    stops = build_stops(basis, served, room, modes, corrected)
    columns = (_fields(basis, used, len(stops.columns)) @ stops.columns).transpose(2, 1, 0)
    nodes = np.searchsorted(stops.poisson, stops.nodes)
    data = {
        "volume": basis.volume,
        "positions": packed(*quantised(basis.vertices[used].T, _POSITION)),
        "faces": packed(faces.reshape(-1, 3).astype(np.uint16)),
        "columns": packed(*quantised(columns, _COLUMN)),
        "poisson": packed(stops.poisson),
        "angular": packed(stops.angular),
        "following": packed(np.sqrt([one.following for one in stops.solved])),
        "nodes": packed(stops.nodes),
        "rotations": packed(*quantised(stops.rotations, _ROTATION)),
        "errors": packed(np.float32([stops.solved[place].discretisation_error for place in nodes])),
    }
    return {**data, "measured": measured_error(basis, stops, served, true, data, random)}


def measured_error(basis: ModalBasis, stops: Stops, named, faces: np.ndarray, data: dict, random) -> dict:
    """Return how far strikes on the page are from those on the body itself, in decibels.

    Random points of the surface are struck in both. ``rms_db`` is over the levels of third-octave bands, down to 40 dB
    below the loudest one of a strike; it is the largest of all stops, ``named_rms_db`` of the Poisson's ratios
    ``named`` (None without any). ``level_db`` is the largest difference between the levels of whole sounds. The levels
    are those of displacement.
    """
    normals, areas = surfaces.normals_and_areas(basis.vertices, faces)
    struck = random.choice(len(faces), _POINTS, p=areas / areas.sum())
    weights = random.dirichlet(np.ones(3), _POINTS)
    fields = _fields(basis, faces[struck].ravel(), len(stops.columns)).reshape(_POINTS, 3, 3, -1)
    exact = np.einsum("pcdr,pc,pd->pr", fields, weights, normals[struck])
    points = np.einsum("pcd,pc->pd", basis.vertices[faces[struck]], weights)
    gains = _page_gains(data, points)
    rotations = unpacked(data["rotations"])
    rms, levels = {}, []
    for poisson, angular, solved in zip(stops.poisson, stops.angular, stops.solved, strict=True):
        true = exact @ solved.coefficients / angular
        page = gains @ rotations[stops.node(poisson)].T / angular
        band = np.unique(np.floor(3 * np.log2(angular)), return_inverse=True)[1]
        inside = np.eye(band.max() + 1)[band]
        bands = [np.maximum(one**2 @ inside, 1e-300) for one in (true, page)]
        heard = bands[0] > bands[0].max(axis=1, keepdims=True) * 10 ** (-_FLOOR_DB / 10)
        rms[float(poisson)] = float(np.sqrt(np.mean(_decibels(*bands)[heard] ** 2)))
        levels.append(np.abs(_decibels(*(one.sum(axis=1) for one in bands))).max())
    return {
        "points": _POINTS,
        "rms_db": max(rms.values()),
        "named_rms_db": max((rms[float(one)] for one in named), default=None),
        "level_db": float(max(levels)),
    }


def _page_gains(data: dict, points: np.ndarray) -> np.ndarray:
    """Return the gains (p, k) of strikes at the places of the page's surface nearest to ``points`` (p, 3)."""
    vertices, columns = unpacked(data["positions"]).T, unpacked(data["columns"])
    faces = unpacked(data["faces"]).astype(int)
    found = [contact(vertices, faces, point) for point in points]
    return np.array([one.weights(columns[:, :, one.corners].transpose(0, 2, 1)) for one in found])


def _fields(basis: ModalBasis, vertices: np.ndarray, size: int) -> np.ndarray:
    """Return the first fields of the modal basis and its corrections at some vertices, (v, 3, size)."""
    fields = np.concatenate([basis.surface[vertices], basis.correction_surface[vertices]], axis=2)
    return fields[..., :size].astype(np.float64)


def _decibels(true: np.ndarray, found: np.ndarray) -> np.ndarray:
    return 10.0 * np.log10(found / true)
