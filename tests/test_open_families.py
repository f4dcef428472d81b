"""Open-ended families: bodies that are sound, differ widely, and never change; the maps and checks they are made of."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from manifold3d import Manifold

from vibraverse.contract.errors import Refused
from vibraverse.contract.seeds import rng
from vibraverse.files.meshes import ply_bytes
from vibraverse.geometry import surfaces
from vibraverse.geometry.distance.crossing import crossing_faces
from vibraverse.geometry.moments import scale_free_moments
from vibraverse.sources.families import GROUPS, drawn, generate, warps
from vibraverse.sources.families import fields as level_sets
from vibraverse.sources.families.redraw import MAX_DRAWS, OpenShape
from vibraverse.sources.families.solids import arrays, solid
from vibraverse.sources.families.soundness import flaw, too_close

OPEN = GROUPS["open-ended"]
NUMBERS = range(100, 103)

#: Arrangement of number 7, its volume over the cube of the longest side, and its area over the square.
PINNED = {
    "tree": (3614059051329876, 0.08708, 1.5606),
    "blend": (1401693621615302, 0.06616, 1.1467),
    "lathe": (2632600429992393, 0.22386, 3.1717),
    "sweep": (3347756951766708, 0.02384, 0.6770),
    "shell": (8793422839366692, 0.08613, 1.7250),
    "bent": (7251222948222847, 0.09139, 1.9306),
    "perforated": (3643706297800440, 0.13092, 1.7278),
}


@pytest.fixture(scope="module")
def bodies():
    return {name: [generate(f"{name}-{number:04d}") for number in NUMBERS] for name in OPEN}


def test_there_are_seven():
    assert OPEN == ["tree", "blend", "lathe", "sweep", "shell", "bent", "perforated"]


@pytest.mark.parametrize("name", OPEN)
def test_bodies_are_one_closed_manifold_piece_that_does_not_meet_itself(bodies, name):
    for body in bodies[name]:
        found = surfaces.topology(body.faces, len(body.vertices))
        assert found.closed_manifold
        assert found.components == 1
        assert surfaces.volume(body.vertices, body.faces) > 0.003 * body.size_m**3
        assert not crossing_faces(body.vertices, body.faces).any()
        assert 2000 <= len(body.faces) <= 20_000
        assert np.ptp(body.vertices, axis=0).min() > 0.04 * body.size_m


def test_bodies_of_a_family_differ_more_than_those_of_parametric_ones(bodies):
    """The spread of bodies' scale-free moments, in octaves, is twice that of typical parametric families."""
    siblings = {name: [generate(f"{name}-{number:04d}") for number in NUMBERS] for name in _QUICK}
    assert np.median([*map(spread, bodies.values())]) > 2 * np.median([*map(spread, siblings.values())])


_QUICK = ("bowl", "bell", "vase", "bar", "gear", "key", "pawn", "knot")


def spread(made) -> float:
    """Return the standard deviation of the logarithms of the scale-free moments, in octaves."""
    moments = [scale_free_moments(body.vertices, body.faces) for body in made]
    return float(np.linalg.norm(np.std(np.log2(moments), axis=0)))


@pytest.mark.parametrize("name", OPEN)
def test_an_object_never_changes(name):
    """Shape to a thousandth on any processor; where rounding differs, Mmg may choose other triangles."""
    body = generate(f"{name}-0007")
    arrangement, volume, area = PINNED[name]
    assert drawn(f"{name}-0007").arrangement == arrangement
    assert surfaces.volume(body.vertices, body.faces) / body.size_m**3 == pytest.approx(volume, rel=1e-3)
    assert surfaces.area(body.vertices, body.faces) / body.size_m**2 == pytest.approx(area, rel=1e-3)


def test_ids_are_the_same_bytes_in_another_process_on_one_core(bodies):
    program = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))});"
        "import hashlib; from vibraverse.files.meshes import ply_bytes; "
        "from vibraverse.sources.families import generate;\n"
        f"for name in {OPEN}:\n"
        "    made = generate(f'{name}-0100');"
        "    print(hashlib.sha256(ply_bytes(made.vertices, made.faces)).hexdigest())"
    )
    other = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    here = [bodies[name][0] for name in OPEN]
    assert other.stdout.split() == [
        hashlib.sha256(ply_bytes(body.vertices, body.faces)).hexdigest() for body in here
    ]


def test_draws_end_in_a_refusal_and_not_in_a_loop():
    drawn = []

    @dataclass(frozen=True)
    class Nothing(OpenShape):
        def body(self, random):
            drawn.append(random.random())

    with pytest.raises(Refused, match=f"None of {MAX_DRAWS} draws of a nothing"):
        Nothing(size_m=1.0, arrangement=5).build()
    assert len(set(drawn)) == MAX_DRAWS
    assert drawn[3] == rng("5", "Nothing", "3").random()


def bar(length=1.0, width=0.2, edge=0.03):
    return arrays(Manifold.cube([width, width, length], center=True).refine_to_length(edge))


def test_twisting_and_bending_keep_the_volume_and_tapering_scales_it():
    vertices, faces = bar()
    assert surfaces.volume(warps.twist(vertices, 0.3), faces) == pytest.approx(0.04, rel=0.02)
    # Pappus: the middle line keeps its length.
    bent = solid((warps.bend(vertices, 3.0), faces))
    assert bent.volume() == pytest.approx(0.04, rel=0.01)
    assert np.ptp(arrays(bent)[0][:, 2]) == pytest.approx(2 * (1 / 3 + 0.1) * np.sin(1.5), rel=1e-3)
    # A pyramid without its tip: h/3 (A + B + sqrt(AB)).
    tapered = surfaces.volume(warps.taper(vertices, 0.5, 1.0), faces)
    assert tapered == pytest.approx(0.04 * (1 + 0.25 + 0.5) / 3, rel=0.01)


def test_waves_keep_the_thickness_across_a_sheet():
    vertices, faces = arrays(Manifold.cube([1, 1, 0.1], center=True).refine_to_length(0.03))
    wave = [(np.array([6.0, 2.0]), 0.3, 0.08)]
    volume = surfaces.volume(warps.waves(vertices, wave), faces)
    x = np.linspace(-0.5, 0.5, 401)
    slope = 0.08 * np.cos(6 * x[:, None] + 2 * x[None, :] + 0.3) * np.hypot(6, 2)
    assert volume == pytest.approx(0.1 * np.sqrt(1 + slope**2).mean(), rel=0.01)


def test_a_level_set_is_the_body_of_its_field():
    low, high = -np.ones(3), np.ones(3)
    ball = level_sets.level_set(level_sets.ball(np.array([0.7])), low, high, 40)
    assert ball.volume() == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=0.01)
    a, b = np.random.default_rng(1).normal(size=(2, 1000))
    union, cut = level_sets.soft_union(a, b, 0.2), level_sets.soft_cut(a, b, 0.2)
    assert (union <= np.minimum(a, b)).all()
    assert (union >= np.minimum(a, b) - 0.05).all()
    assert (cut >= np.maximum(a, -b)).all()


@pytest.mark.parametrize(("thickness", "expected"), [(0.06, False), (0.04, True)])
def test_a_thin_plate_is_found(thickness, expected):
    plate = Manifold.cube([1, 1, thickness], center=True).refine_to_length(0.025)
    assert too_close(*arrays(plate)) is expected


@pytest.mark.parametrize(("gap", "expected"), [(0.03, False), (0.012, True)])
def test_a_narrow_gap_is_found(gap, expected):
    slotted = Manifold.cube([1, 1, 0.5], center=True) - Manifold.cube([1, 0.9, gap], center=True).translate(
        [0, 0.1, 0]
    )
    assert too_close(*arrays(slotted.refine_to_length(0.025))) is expected


def test_flaws_are_named():
    ball = Manifold.sphere(0.5, 64)
    assert flaw(*arrays(ball)) is None
    assert "triangles" in flaw(*arrays(Manifold.sphere(0.5, 16)))
    assert flaw(*arrays(Manifold.compose([ball, ball.translate([2, 0, 0])]))) == "not one closed piece"
    vertices, faces = arrays(ball)
    assert flaw(vertices[:, :], faces[1:]) == "not one closed piece"
    assert flaw(vertices * [1, 1, 0.02], faces) in ("too flat", "too little volume", "poor triangles")
