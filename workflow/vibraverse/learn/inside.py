"""The inside of a body, as a network that proposes displacement fields sees it.

The tetrahedra stand in the body's own frame: the origin in the centre of mass, the axes along the principal ones, each
pointing to the longer tail (positive third moment), lengths over the cube root of the volume. A rotated, mirrored or
scaled body is the same there. Where the body is its own mirror image the sign of an axis is arbitrary, and so are axes
of equal moments within their plane; training turns and mirrors bodies at random in the same way.

A place is told by more than its coordinates. The lowest harmonics of the body (eigenfunctions of the Laplacian with a
free boundary) run along its arms and around its rings, and the torsion function (``-Δw = 1``, zero on the surface) says
how far inside it lies. Unlike the distance to the surface, which has kinks, these are smooth. Linear elements on the
same tetrahedra give them in a moment.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.linalg import eigsh, splu

from vibraverse.contract.seeds import rng
from vibraverse.geometry.boundary import boundary
from vibraverse.geometry.meshing.quality import volumes as signed_volumes

#: Number of harmonics, the constant one not counted.
HARMONICS = 16
#: Fewer vertices than this are solved with dense matrices.
_DENSE = 200
#: Share of the larger moment by which two axes may differ and still be turned into each other.
_NEARLY_EQUAL = 0.1


def describe(points: np.ndarray, cells: np.ndarray) -> dict[str, np.ndarray]:
    """Return tetrahedra (N, 3), (T, 4) in their own frame, and what is known of their vertices and of the body.

    ``points`` (N, 3), ``cells`` (T, 4) and ``fields`` (N, 1 + h) float32: the torsion function over its largest value,
    then the harmonics of mean square one. ``scales`` (1 + h,) float32 are the logarithms of that largest value and of
    the harmonics' eigenvalues. Vertices of no tetrahedron are left out.
    """
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 4).astype(np.int32)
    points = in_own_frame(points[used], cells)
    if signed_volumes(points, cells[:1])[0] < 0:
        cells = cells[:, [1, 0, 2, 3]]  # the frame is left-handed, and elements must be positively oriented
    stiffness, mass = _laplacian(points, cells)
    torsion = _torsion(stiffness, mass, boundary(cells)[1])
    values, harmonics = _harmonics(stiffness, mass)
    highest = max(torsion.max(), np.finfo(np.float32).tiny)
    return {
        "points": points,
        "cells": cells,
        "fields": np.column_stack([torsion / highest, _signed(harmonics, points, mass)]).astype(np.float32),
        "scales": np.log(np.append(highest, np.maximum(values, 1e-6))).astype(np.float32),
    }


def in_own_frame(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the vertices (N, 3) of tetrahedra (T, 4) in the frame of the body, over the cube root of its volume."""
    corners = points[cells]
    volumes = np.abs(signed_volumes(points, cells))
    volume = volumes.sum()
    centre = volumes @ corners.mean(axis=1) / volume
    corners = corners - centre
    total = corners.sum(axis=1)
    # ∫ x xᵀ over a tetrahedron is V/20 (Σ x_i x_iᵀ + s sᵀ), with s the sum of its corners.
    second = np.einsum("t,tia,tib->ab", volumes, corners, corners) + np.einsum(
        "t,ta,tb->ab", volumes, total, total
    )
    axes = np.linalg.eigh(second)[1]
    along = corners @ axes
    # ∫ ξ³ is V/20 times the sum of all products of three corners, which Newton's identities give.
    first, squares, cubes = (np.sum(along**power, axis=1) for power in (1, 2, 3))
    third = volumes @ (first**3 + 3 * first * squares + 2 * cubes)
    return (points - centre) @ (axes * np.where(third < 0, -1.0, 1.0)) / np.cbrt(volume)


def slopes(corners: np.ndarray) -> np.ndarray:
    """Return the gradients (T, 4, 3) of the barycentric coordinates of tetrahedra (T, 4, 3)."""
    inner = np.swapaxes(np.linalg.inv(corners[:, 1:] - corners[:, :1]), 1, 2)
    return np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)


def draw(points, cells, values, count: int, random) -> tuple[np.ndarray, np.ndarray]:
    """Return ``values`` (N, k) of the vertices at ``count`` points inside (c, k), and their gradients (c, 3, k).

    The points are uniform: each stands for the same volume. They are drawn evenly along the list of tetrahedra, which
    halves the error of integrals against independent ones.
    """
    cells = np.sort(
        cells, axis=1
    )  # a mirrored body has its corners in another order, and gets the same points
    corners = points[cells]
    reached = np.cumsum(np.abs(signed_volumes(points, cells)))
    places = (np.arange(count) + random.random()) / count * reached[-1]
    chosen = np.minimum(np.searchsorted(reached, places), len(cells) - 1)
    shares = random.dirichlet(np.ones(4), size=count)
    at = values[cells[chosen]]
    gradients = np.einsum("cia,cik->cak", slopes(corners[chosen]), at)
    return np.einsum("ci,cik->ck", shares, at), gradients


def turn(points: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return a random rotation among axes of nearly equal moments (3, 3), with random mirrorings."""
    moments = np.square(points).mean(axis=0)
    found = np.diag(random.choice([-1.0, 1.0], size=3))
    for one in range(3):
        other = (one + 1) % 3
        if abs(moments[one] - moments[other]) < _NEARLY_EQUAL * max(moments[one], moments[other]):
            angle = random.uniform(0, 2 * math.pi)
            c, s = math.cos(angle), math.sin(angle)
            step = np.eye(3)
            step[np.ix_([one, other], [one, other])] = [[c, -s], [s, c]]
            found = found @ step
    return found


def _laplacian(points: np.ndarray, cells: np.ndarray) -> tuple[sp.csc_matrix, np.ndarray]:
    """Return the stiffness (N, N) of linear elements and the lumped mass (N,)."""
    corners = points[cells]
    volumes, gradients = np.abs(signed_volumes(points, cells)), slopes(corners)
    blocks = np.einsum("t,tia,tja->tij", volumes, gradients, gradients)
    rows, columns = np.repeat(cells, 4, axis=1).ravel(), np.tile(cells, (1, 4)).ravel()
    stiffness = sp.csc_matrix((blocks.ravel(), (rows, columns)), shape=(len(points),) * 2)
    return stiffness, np.bincount(cells.ravel(), np.repeat(volumes / 4, 4), len(points))


def _torsion(stiffness: sp.csc_matrix, mass: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Return the torsion function (N,), zero at the vertices ``fixed``; all zero if there is no other."""
    found = np.zeros(len(mass))
    free = np.setdiff1d(np.arange(len(mass)), fixed)
    if len(free):
        found[free] = splu(stiffness[free][:, free].tocsc()).solve(mass[free])
    return found


def _harmonics(stiffness: sp.csc_matrix, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest eigenvalues (h,) and eigenfunctions (N, h) but the first, of mean square one.

    A body with fewer vertices has zeros in place of those that it lacks.
    """
    count = min(HARMONICS, len(mass) - 1)
    if len(mass) < _DENSE:
        values, vectors = scipy.linalg.eigh(stiffness.toarray(), np.diag(mass), subset_by_index=(0, count))
    else:
        start = rng("harmonics").standard_normal(len(mass))
        values, vectors = eigsh(stiffness, count + 1, sp.diags(mass).tocsc(), sigma=-1.0, v0=start)
        order = np.argsort(values)
        values, vectors = values[order], vectors[:, order]
    vectors *= np.sqrt(mass.sum())
    missing = HARMONICS - count
    return np.pad(values[1:], (0, missing), mode="edge"), np.pad(vectors[:, 1:], ((0, 0), (0, missing)))


def _signed(harmonics: np.ndarray, points: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """Return harmonics (N, h) with the signs that the axes give them.

    The product of coordinates, up to three, that a harmonic resembles most is positive in it.
    """
    x, y, z = (points / np.abs(points).max(axis=0)).T
    tests = [x**a * y**b * z**c for a in range(4) for b in range(4) for c in range(4) if 0 < a + b + c <= 3]
    alike = np.stack([one / np.sqrt(mass @ one**2) for one in tests]) @ (mass[:, None] * harmonics)
    chosen = alike[np.abs(alike).argmax(axis=0), np.arange(alike.shape[1])]
    return harmonics * np.where(chosen < 0, -1.0, 1.0)
