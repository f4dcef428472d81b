"""One object, described differently, keeps its frequencies: geometry from cleaning to the eigensolver."""

from __future__ import annotations

import multiprocessing
import os

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vibraverse.files import meshes
from vibraverse.geometry import LONGEST_SIDE
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.grids import Sampler
from vibraverse.geometry.hollow import hollow
from vibraverse.geometry.meshing.tets import tetrahedralise
from vibraverse.physics.basis import build_basis
from vibraverse.physics.modes import reduced_solve
from vibraverse.sources.bundled import locate
from vibraverse.sources.families import generate

MODES = 20
#: Bodies that say the same for minutes more.
MORE = pytest.mark.skipif("VIBRAVERSE_STABILITY" not in os.environ, reason="VIBRAVERSE_STABILITY is not set")


def source(name: str):
    """Return the vertices and faces of a bundled or generated object."""
    mesh = meshes.read_mesh(locate(name), "ply") if name == "nut" else generate(name)
    return mesh.vertices, mesh.faces


def split_edges(vertices, faces, generator, share: float = 0.3):
    """Return the same surface with random edges split at random points."""
    vertices, faces = list(vertices), [tuple(face) for face in faces]
    for _ in range(int(share * len(faces))):
        i = int(generator.integers(len(faces)))
        a, b = faces[i][:2]
        j = next(j for j, face in enumerate(faces) if j != i and a in face and b in face)
        at = generator.uniform(0.3, 0.7)
        vertices.append((1 - at) * np.asarray(vertices[a]) + at * np.asarray(vertices[b]))
        new = len(vertices) - 1
        for face in (faces[i], faces[j]):
            faces.append(tuple(new if corner == a else corner for corner in face))
        for k in (i, j):
            faces[k] = tuple(new if corner == b else corner for corner in faces[k])
    return np.array(vertices), np.array(faces)


def described_anew(vertices, faces, seed: int):
    """Return the surface rotated, scaled, moved, triangulated and numbered differently, and the scale."""
    generator = np.random.default_rng(seed)
    vertices, faces = split_edges(vertices, faces, generator)
    scale = float(np.exp(generator.uniform(-5, 5)))
    rotation = Rotation.random(random_state=seed).as_matrix()
    vertices = scale * (vertices @ rotation.T + generator.normal(size=3))
    order = generator.permutation(len(vertices))
    faces = np.argsort(order)[faces][generator.permutation(len(faces))]
    return vertices[order], np.array([np.roll(face, generator.integers(3)) for face in faces]), scale


def frequencies(vertices, faces, solidity: str, scale: float = 1.0, t: float = 0.5):
    """Return the number of elements and the first frequencies (MODES,) in the units of the object before scaling."""
    body = clean(vertices, faces)
    surface = body.vertices, body.faces
    if solidity == "hollow":
        made = hollow(*surface, Sampler(*surface).signed_distance(128), t)
        surface = made.vertices, made.faces
    mesh = tetrahedralise(*surface)
    basis = build_basis(
        mesh.points, mesh.cells, rng=np.random.default_rng(0), modes=MODES, poisson_range=(0.3, 0.3)
    )
    hz = np.sqrt(reduced_solve(basis, 0.3, MODES).values) * LONGEST_SIDE / (body.longest_side / scale)
    return len(mesh.cells), hz


@pytest.mark.parametrize(
    ("name", "solidity", "tolerance"),
    [
        ("nut", "solid", 2e-3),
        ("tuning-fork-0000", "hollow", 5e-3),
        pytest.param("bowl-0000", "hollow", 5e-3, marks=MORE),
        pytest.param("bell-0000", "solid", 2e-3, marks=MORE),
        pytest.param("tuning-fork-0000", "solid", 2e-3, marks=MORE),
        pytest.param("cup-0000", "solid", 5e-3, marks=MORE),
        pytest.param("nut", "hollow", 5e-3, marks=MORE),
    ],
)
def test_frequencies_belong_to_the_object_not_to_its_description(name, solidity, tolerance):
    # In a process of its own, because this one would keep the memory of the largest mesh for all tests to come.
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        reference, found = pool.apply(twice, (name, solidity))
    assert reference[0] > 0
    assert np.abs(found / reference - 1).max() < tolerance


def twice(name: str, solidity: str):
    """Return the frequencies of an object as it comes, and described anew."""
    vertices, faces = source(name)
    *anew, scale = described_anew(vertices, faces, seed=7)
    return frequencies(vertices, faces, solidity)[1], frequencies(*anew, solidity, scale)[1]
