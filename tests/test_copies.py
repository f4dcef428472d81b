"""Copies of one shape through the real chain: fingerprints that agree, and those of near misses that do not."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from vibraverse.contract.seeds import rng
from vibraverse.dataset.split.copies import groups, scale_free_spectrum
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.meshing.tets import tetrahedralise
from vibraverse.geometry.moments import scale_free_moments
from vibraverse.physics.basis import build_basis
from vibraverse.sources.families import generate


def test_moments_of_known_bodies():
    box = trimesh.creation.box((3, 2, 1))
    # ∫ x² dV = V a² / 12 for the side a.
    expected = [6 * side**2 / 12 / 6 ** (5 / 3) for side in (1, 2, 3)] + [22 / 6 ** (2 / 3)]
    assert scale_free_moments(box.vertices, box.faces) == pytest.approx(expected, rel=1e-12)
    ball = trimesh.creation.icosphere(5, 2.0)
    volume = 4 / 3 * np.pi
    expected = [volume / 5 / volume ** (5 / 3)] * 3 + [4 * np.pi / volume ** (2 / 3)]
    assert scale_free_moments(ball.vertices + [5, 1, -3], ball.faces) == pytest.approx(expected, rel=2e-3)


def turned(vertices, seed: int):
    """Rotate by a random rotation."""
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return vertices @ (q * np.sign(np.linalg.det(q)))


def variants() -> dict[str, tuple]:
    """Return a spoon, its copies, and objects that only look like it."""
    mesh = generate("spoon-0003")
    vertices, faces = np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)
    # A third of the triangles get a vertex in their middle: other triangles, the same surface.
    split = faces[::3]
    middle = len(vertices) + np.arange(len(split))
    a, b, c = split.T
    fan = np.concatenate([np.column_stack(t) for t in ((a, b, middle), (b, c, middle), (c, a, middle))])
    rest = np.delete(faces, slice(None, None, 3), axis=0)
    remade = np.concatenate([vertices, vertices[split].mean(axis=1)]), np.concatenate([rest, fan])
    order = np.random.default_rng(1).permutation(len(vertices))
    stretched = vertices * [1.0, 1.0, 1.04]
    bent = vertices.copy()
    along = np.argmax(np.ptp(vertices, axis=0))
    across = np.argmin(np.ptp(vertices, axis=0))
    half = np.ptp(vertices[:, along]) / 2
    bent[:, across] += 0.12 * half * ((vertices[:, along] - vertices[:, along].mean()) / half) ** 2
    return {
        "spoon": (vertices, faces),
        "spoon-exact": (vertices, faces),
        "spoon-remade": remade,
        "spoon-renumbered": (vertices[order], np.argsort(order)[faces]),
        "spoon-turned-and-scaled": (3.7 * turned(vertices, 2) + [1, 2, 3], faces),
        "spoon-mirrored": (vertices * [-1, 1, 1], faces[:, ::-1]),
        "miss-stretched": (stretched, faces),
        "miss-bent": (bent, faces),
        "miss-other": (np.asarray(generate("spoon-0004").vertices), np.asarray(generate("spoon-0004").faces)),
    }


def test_copies_are_found_and_near_misses_are_not():
    fingerprints = {}
    for name, surface in variants().items():
        body = clean(*surface)
        tets = tetrahedralise(body.vertices, body.faces, target_elements=2000)
        basis = build_basis(tets.points, tets.cells, rng=rng(name), modes=24, max_error=1e-4)
        fingerprints[name] = scale_free_moments(body.vertices, body.faces), scale_free_spectrum(basis)
    found = groups(fingerprints)
    assert {name for name, first in found.items() if first == "spoon"} == {
        name for name in fingerprints if name.startswith("spoon")
    }
    assert all(found[name] == name for name in fingerprints if name.startswith("miss"))
