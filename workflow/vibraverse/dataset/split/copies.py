"""The search for copies of one shape, however it is triangulated, rotated, mirrored or scaled.

Every object has a fingerprint that such changes do not affect: the moments of its surface
(:mod:`vibraverse.geometry.moments`) and the lowest frequencies of its solid body, scale-free: ``ω̂ V^(1/3)`` for
E = ρ = 1 and ν = 0.25. Two objects are copies if both agree within tolerances; copies of copies belong together.

Moments of one surface agree to rounding, and within a fraction of a per cent after remeshing or decimation. Frequencies
carry the mesh's error: some tenths of a per cent, and a few per cent for single modes of thin bodies
(benchmarks/README.md).
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

#: Poisson's ratio and number of frequencies of the fingerprint.
_POISSON, _MODES = 0.25, 20
#: Largest differences of logarithms between copies: of every moment, of the median frequency, of every frequency.
MOMENT_TOLERANCE, MEDIAN_TOLERANCE, FREQUENCY_TOLERANCE = 0.01, 0.005, 0.03
#: Tolerance of moments if a body has no frequencies.
_MOMENTS_ALONE_TOLERANCE = 0.002


def scale_free_spectrum(basis) -> np.ndarray:
    """Return ``ω̂ V^(1/3)`` of the lowest 20 modes of a body, from its ModalBasis; fewer if it has fewer."""
    from vibraverse.physics.modes import reduced_solve

    poisson = float(np.clip(_POISSON, *basis.poisson_range))
    values = reduced_solve(basis, poisson, min(_MODES, len(basis.residuals))).values
    return np.sqrt(values) * basis.volume ** (1 / 3)


def same_shape(moments: np.ndarray, spectra: list, pairs: np.ndarray) -> np.ndarray:
    """Return the mask of the pairs (p, 2) of objects that are copies.

    ``moments`` (n, 4) and ``spectra`` (n arrays, None where unknown) are logarithms.
    """
    apart = np.abs(moments[pairs[:, 0]] - moments[pairs[:, 1]]).max(axis=1)
    same = apart <= MOMENT_TOLERANCE
    for row in np.flatnonzero(same):
        first, second = (spectra[number] for number in pairs[row])
        if first is None or second is None:
            same[row] = apart[row] <= _MOMENTS_ALONE_TOLERANCE
            continue
        count = min(len(first), len(second))
        difference = np.abs(first[:count] - second[:count])
        same[row] = np.median(difference) <= MEDIAN_TOLERANCE and difference.max() <= FREQUENCY_TOLERANCE
    return same


def groups(fingerprints: dict[str, tuple]) -> dict[str, str]:
    """Return the first of its copies for every object; itself if it has no earlier one.

    ``fingerprints`` maps ids to moments (4,) and spectrum (k,) or None. The first is the least id in natural order:
    ``bowl-9`` before ``bowl-10``.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    ids = sorted(fingerprints, key=natural)
    if not ids:
        return {}
    moments = np.log([fingerprints[one][0] for one in ids])
    spectra = [None if fingerprints[one][1] is None else np.log(fingerprints[one][1]) for one in ids]
    pairs = cKDTree(moments).query_pairs(MOMENT_TOLERANCE, p=np.inf, output_type="ndarray")
    pairs = pairs[same_shape(moments, spectra, pairs)]
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(ids), len(ids)))
    labels = connected_components(links, directed=False)[1]
    first: dict[int, str] = {}
    for label, one in zip(labels, ids, strict=True):
        first.setdefault(label, one)
    return {one: first[label] for label, one in zip(labels, ids, strict=True)}


def natural(text: str) -> list:
    """Return the key for sorting texts in natural order, with numbers compared as numbers."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", text)]


def fingerprints_of(reader, objects: Iterable[str]) -> dict[str, tuple]:
    """Return moments and spectrum (or None) of a reader's objects."""
    found = {}
    for object_id in objects:
        shape = reader.group(object_id)["shape"]
        found[object_id] = shape["moments"][()], shape["spectrum"][()] if "spectrum" in shape else None
    return found
