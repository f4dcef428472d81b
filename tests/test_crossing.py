"""crossing: constructed pairs, random ones against an independent rational test, known cuts."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import shapes
from vibraverse.geometry import repair
from vibraverse.geometry.distance.crossing import crossing_faces

FLAT = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], dtype=float)


def cross(*triangles):
    """Return whether the triangles, with equal points joined, cross."""
    points = np.concatenate([np.asarray(triangle, dtype=float) for triangle in triangles])
    return crossing_faces(*repair.weld(points, np.arange(len(points)).reshape(-1, 3))).tolist()


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (FLAT + [5, 0, 0], False),
        (FLAT + [0.2, 0.2, 1e-12], False),
        (((0.2, 0.2, -1), (0.2, 0.2, 1), (0.3, 0.9, 1)), True),  # pierces
        (FLAT + [0.2, 0.2, 0], True),  # overlaps in one plane
        (((0.2, 0.2, 0), (0.4, 0.2, 0), (0.2, 0.4, 0)), True),  # lies inside
        (((0.25, 0.25, 0), (0.5, 0.25, 1), (0.25, 0.5, 1)), True),  # a point touches the face
        (((0.5, 0, 0), (0.4, -1, 1), (0.6, -1, 1)), True),  # a point touches the edge: a T-junction
        (((1, 0, 0), (0, 0, 0), (0.5, -1, 0)), False),  # neighbours in one plane
        (((1, 0, 0), (0, 0, 0), (0.2, 0.6, 0)), True),  # neighbours folded flat on one another
        (((1, 0, 0), (0, 0, 0), (0.2, 0.6, 1e-9)), False),  # and almost
        (((0, 0, 0), (-1, 0, 0), (0, -1, 0)), False),  # corner to corner
        (((0, 0, 0), (-1, 0, 0), (-1, -1, 0)), False),  # corner to corner, edges in one line
        (((0, 0, 0), (0.3, 0.3, -1), (0.3, 0.3, 1)), True),  # from the corner through the face
        (((0, 0, 0), (1, 1, -1), (1, 1, 1)), True),
        (((0, 0, 0), (0.5, 0.1, 0), (0.5, 0.3, 0)), True),  # from the corner, in the plane
        (((0, 0, 0), (0.3, 0.3, 0), (0.3, 0.3, 1)), True),  # from the corner, an edge in the face
        (((0, 0, 0), (0.5, 0, 0), (0.3, 0.3, 1)), True),  # from the corner, edge along edge
        (FLAT[::-1], True),
    ],
)
def test_constructed_pairs(other, expected):
    assert cross(FLAT, other) == [expected] * 2
    # The same pair far smaller; a power of two changes no bit of the digits.
    assert cross(2.0**-30 * FLAT, 2.0**-30 * np.asarray(other, dtype=float)) == [expected] * 2


def segment_meets(p, q, triangle) -> bool:
    """Return whether a closed segment meets a closed triangle, by solving for the point in rational numbers."""
    a, b, c = triangle
    d, e, f = (q - p), (b - a), (c - a)
    normal = np.cross(e, f)
    rise, height = int(d @ normal), int((a - p) @ normal)
    if rise == 0:
        if height:
            return False
        # In the plane, where the coordinate along which the normal is largest can go.
        keep = [axis for axis in range(3) if axis != int(np.abs(normal).argmax())]
        corners, ends = [x[keep] for x in triangle], (p[keep], q[keep])
        return any(segments_meet(*ends, corners[i - 1], corners[i]) for i in range(3)) or in_flat(
            ends[0], corners
        )
    share = Fraction(height, rise)
    if not 0 <= share <= 1:
        return False
    keep = [axis for axis in range(3) if axis != int(np.abs(normal).argmax())]
    at = [Fraction(int(x)) + share * int(y) for x, y in zip(p[keep], d[keep], strict=True)]
    return in_flat(at, [x[keep] for x in triangle])


def turn(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def in_flat(point, corners) -> bool:
    turns = [turn(corners[i - 1], corners[i], point) for i in range(3)]
    return all(t >= 0 for t in turns) or all(t <= 0 for t in turns)


def segments_meet(a, b, c, d) -> bool:
    one, two, three, four = turn(a, b, c), turn(a, b, d), turn(c, d, a), turn(c, d, b)
    if one == two == three == four == 0:
        return all(
            max(min(a[k], b[k]), min(c[k], d[k])) <= min(max(a[k], b[k]), max(c[k], d[k])) for k in range(2)
        )
    return one * two <= 0 and three * four <= 0


def test_random_pairs_on_a_small_lattice_touch_often_and_are_told_right():
    generator = np.random.default_rng(5)
    met = 0
    for _ in range(1500):
        p, q = generator.integers(0, 5, (2, 3, 3))
        shared = len({tuple(x) for x in p} & {tuple(x) for x in q})
        if (
            shared
            or not np.cross(p[1] - p[0], p[2] - p[0]).any()
            or not np.cross(q[1] - q[0], q[2] - q[0]).any()
        ):
            continue
        expected = any(segment_meets(a[i - 1], a[i], b) for a, b in ((p, q), (q, p)) for i in range(3))
        assert cross(p, q) == [expected] * 2, (p, q)
        met += expected
    assert 200 < met < 1200


def test_bodies_that_cut_or_only_touch_are_told_and_others_are_not():
    assert not crossing_faces(*shapes.ball()).any()
    assert not crossing_faces(*shapes.together(shapes.box(), shapes.box(centre=(1.9, 0, 0)))).any()
    # All but the two faces at the far side of each box have a point in the plane where the boxes touch.
    assert crossing_faces(*shapes.together(shapes.box(), shapes.box(centre=(1.8, 0, 0)))).sum() == 20
    cut = crossing_faces(*shapes.together(shapes.ball(), shapes.ball(radius=0.5, centre=(0.9, 0, 0))))
    # Only faces near the circle of the two spheres are told: x = 0.7611, radius 0.4803.
    corners = np.concatenate([m[0][m[1]] for m in (shapes.ball(), shapes.ball(0.5, centre=(0.9, 0, 0)))])[cut]
    away = np.hypot(corners[..., 0] - 0.7611, np.hypot(corners[..., 1], corners[..., 2]) - 0.4803)
    assert cut.sum() > 100
    assert away.max() < 0.15
