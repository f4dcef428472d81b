"""clean: however a mesh is damaged, the result is the surface of one solid, or a refusal.

Bodies are broken by a few random steps each. The quick run takes the same examples every time; set
``VIBRAVERSE_FUZZ`` to a number for so many new ones.
"""

from __future__ import annotations

import os
import time

import manifold3d
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import shapes
from vibraverse.contract.errors import Refused
from vibraverse.geometry import repair, surfaces
from vibraverse.geometry.cleaning.clean import clean
from vibraverse.geometry.cleaning.judge import judge
from vibraverse.geometry.distance.deviation import deviation

EXAMPLES = int(os.environ.get("VIBRAVERSE_FUZZ", "0"))
SECONDS = 60.0


def torus():
    from trimesh.creation import torus as made

    mesh = made(0.6, 0.25, major_sections=24, minor_sections=12)
    return np.array(mesh.vertices), np.array(mesh.faces)


def moebius(n=40, width=0.3):
    """Return a Möbius band."""
    u = np.linspace(0, 2 * np.pi, n, endpoint=False)[:, None]
    v = np.array([-width, width])
    ring = 0.6 + v * np.cos(u / 2)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), v * np.sin(u / 2)], axis=-1).reshape(-1, 3)
    return points, ladder_faces(n, 2, flip=True)


def klein(n=32, m=16):
    """Return the figure-eight Klein bottle."""
    u, v = np.meshgrid(2 * np.pi * np.arange(n) / n, 2 * np.pi * np.arange(m) / m, indexing="ij")
    r = 0.5 + 0.2 * (np.cos(u / 2) * np.sin(v) - np.sin(u / 2) * np.sin(2 * v))
    z = 0.2 * (np.sin(u / 2) * np.sin(v) + np.cos(u / 2) * np.sin(2 * v))
    points = np.stack([r * np.cos(u), r * np.sin(u), z], axis=-1).reshape(-1, 3)
    i = np.arange(n * m)
    a, b = i // m, i % m
    right, up = (b + 1) % m, (a + 1) % n
    # After one turn the angle of the small circle runs the other way.
    turned = np.where(a + 1 == n, (-b) % m, b), np.where(a + 1 == n, (-right) % m, right)
    low, high = i, a * m + right
    far, corner = up * m + turned[0], up * m + turned[1]
    return points, np.concatenate([np.stack([low, far, high], 1), np.stack([high, far, corner], 1)])


def ladder_faces(n, m, flip):
    """Return the faces of a closed strip of ``n`` by ``m`` points, with a half turn when ``flip``."""
    faces = []
    for i in range(n):
        for j in range(m - 1):
            a, b = i * m + j, i * m + j + 1
            up = (i + 1) % n
            c, d = up * m + j, up * m + j + 1
            if flip and up == 0:
                c, d = m - 1 - j, m - 2 - j
            faces += [(a, c, b), (b, c, d)]
    return np.array(faces)


BODIES = {
    "ball": lambda: shapes.ball(subdivisions=2),
    "box": shapes.box,
    "fine-box": lambda: shapes.split(*shapes.split(*shapes.box((1.8, 1.0, 0.4)))),
    "cylinder": lambda: shapes.cylinder(0.3, 1.8, 16),
    "torus": torus,
    "hollow": lambda: shapes.hollow_ball(subdivisions=2),
    "plate": lambda: shapes.split(*shapes.box((1.8, 1.2, 0.02))),
    "sheet": shapes.sheet,
    "moebius": moebius,
    "klein": klein,
}


def lose(vertices, faces, random):
    """Lose up to a third of the faces."""
    return vertices, faces[random.random(len(faces)) > random.uniform(0, 0.33)]


def punch(vertices, faces, random):
    """Lose the faces around a point."""
    away = np.linalg.norm(vertices[faces].mean(axis=1) - vertices[random.integers(len(vertices))], axis=1)
    return vertices, faces[away > random.uniform(0, 0.6)]


def flip(vertices, faces, random):
    which = random.random(len(faces)) < random.uniform(0, 1)
    return vertices, np.where(which[:, None], faces[:, ::-1], faces)


def double(vertices, faces, random):
    return vertices, np.concatenate([faces, faces[random.random(len(faces)) < 0.3][:, [1, 2, 0]]])


def jitter(vertices, faces, random):
    return vertices + random.normal(0, 10.0 ** random.uniform(-12, -0.7), vertices.shape), faces


def soup(vertices, faces, random):
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def collapse(vertices, faces, random):
    """Move some vertices onto their neighbours, which leaves faces without area."""
    vertices = vertices.copy()
    edges = faces[random.random(len(faces)) < 0.1][:, :2]
    vertices[edges[:, 0]] = vertices[edges[:, 1]]
    return vertices, faces


def stray(vertices, faces, random):
    """Add triangles anywhere."""
    points = random.uniform(-0.9, 0.9, (3 * random.integers(1, 6), 3))
    return shapes.together((vertices, faces), (points, np.arange(len(points)).reshape(-1, 3)))


def wall(vertices, faces, random):
    """Add triangles between the vertices that are there."""
    if len(vertices) < 3:
        return vertices, faces
    return vertices, np.concatenate([faces, random.integers(0, len(vertices), (random.integers(1, 10), 3))])


def again(vertices, faces, random):
    """Add a copy of the body, apart from it or touching it."""
    step = random.uniform(-1, 1, 3) * random.choice([0.0, 0.1, 1.0, 3.0])
    if random.random() < 0.5:
        step = np.ptp(vertices, axis=0) * random.integers(-1, 2, 3)
    return shapes.together((vertices, faces), (vertices + step, faces))


def cut_itself(vertices, faces, random):
    """Pull some vertices through the body."""
    vertices = vertices.copy()
    which = random.integers(0, len(vertices), 3)
    vertices[which] *= random.uniform(-1.2, 0.5, (3, 1))
    return vertices, faces


def junction(vertices, faces, random):
    """Split some edges on one side only."""
    which = np.flatnonzero(random.random(len(faces)) < 0.1)
    middle = 0.5 * (vertices[faces[which, 0]] + vertices[faces[which, 1]])
    new = len(vertices) + np.arange(len(which))
    a, b, c = faces[which].T
    kept = np.delete(faces, which, axis=0)
    halves = np.concatenate([np.stack([a, new, c], 1), np.stack([new, b, c], 1)])
    return np.concatenate([vertices, middle]), np.concatenate([kept, halves])


def degenerate(vertices, faces, random):
    """Add faces over two points, or over three on one line."""
    a, b = faces[random.integers(0, len(faces), 4)][:, :2].T
    middle = len(vertices) + np.arange(4)
    points = np.concatenate([vertices, 0.5 * (vertices[a] + vertices[b])])
    return points, np.concatenate([faces, np.stack([a, b, b], 1), np.stack([a, middle, b], 1)])


def scale(vertices, faces, random):
    return vertices * 10.0 ** random.uniform(-12, 12), faces


def stretch(vertices, faces, random):
    return vertices * 10.0 ** random.uniform(-2, 0, 3), faces


def far(vertices, faces, random):
    return vertices + np.ptp(vertices, axis=0).max() * 10.0 ** random.uniform(0, 6) * random.normal(
        size=3
    ), faces


def round_off(vertices, faces, random):
    """Keep a few digits, as text files do."""
    size = max(float(np.abs(vertices).max()), 1e-300)
    return np.round(vertices / size, int(random.integers(1, 7))) * size, faces


def turn(vertices, faces, random):
    return vertices @ np.linalg.qr(random.normal(size=(3, 3)))[0], faces


BREAKS = [
    lose,
    punch,
    flip,
    double,
    jitter,
    soup,
    collapse,
    stray,
    wall,
    again,
    cut_itself,
    junction,
    degenerate,
]
BREAKS += [scale, stretch, far, round_off, turn]

recipes = st.tuples(
    st.sampled_from(sorted(BODIES)),
    st.lists(st.tuples(st.sampled_from(BREAKS), st.integers(0, 2**32 - 1)), min_size=1, max_size=4),
    st.sampled_from(["refuse", "thicken"]),
)


def cleaned(mesh, sheets):
    """Return the cleaned body, or None when it was refused."""
    try:
        return clean(*mesh, open_sheets=sheets)
    except Refused as refused:
        if not (refused.message and refused.advice):
            raise
        return None


@settings(
    max_examples=EXAMPLES or 10,
    derandomize=not EXAMPLES,
    deadline=None,
    database=None,
    print_blob=False,
    suppress_health_check=list(HealthCheck),
)
@given(recipes)
def test_a_broken_body_becomes_a_solid_or_is_refused(recipe):
    name, steps, sheets = recipe
    mesh = BODIES[name]()
    for step, seed in steps:
        if len(mesh[1]):
            mesh = step(*mesh, np.random.default_rng(seed))
    started = time.process_time()
    body = cleaned(mesh, sheets)
    assert time.process_time() - started < SECONDS
    if body is None:
        return
    judge(body.vertices, body.faces)
    assert np.abs(body.vertices).max() <= 0.9 + 1e-12
    assert np.ptp(body.vertices, axis=0).max() == pytest.approx(1.8, abs=1e-12)
    assert all(step["failed"] for step in body.ladder)
    assert 0 <= body.dropped_share <= 0.5 + 1e-9
    assert np.isfinite([body.deviation.hausdorff, body.area_change, *body.centre]).all()
    # The same, said by another library.
    solid = manifold3d.Manifold(manifold3d.Mesh64(body.vertices, body.faces.astype(np.uint64)))
    assert solid.status() == manifold3d.Error.NoError
    assert solid.volume() == pytest.approx(surfaces.volume(body.vertices, body.faces), rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("name", "within"), [("ball", 0.01), ("fine-box", 1e-6), ("torus", 0.03)])
def test_a_body_with_holes_comes_back(name, within, seed):
    vertices, faces = BODIES[name]()
    random = np.random.default_rng(seed)
    holes = random.choice(len(faces), 6, replace=False)
    body = clean(vertices, np.delete(faces, holes, axis=0))
    assert body.rung == "close"
    there = repair.weld((vertices - body.centre) * body.scale, faces)
    assert surfaces.volume(body.vertices, body.faces) == pytest.approx(surfaces.volume(*there), rel=within)
    # Against the whole body, not against what was left of it.
    assert deviation(there, (body.vertices, body.faces), []).hausdorff < 1.5 * within
