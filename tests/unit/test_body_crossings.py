"""Self-intersection against exact rational arithmetic, an independent library, and cases built by hand."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.body.crossings import crossing_pairs, crossing_triangles

SEEDS = st.integers(0, 10**6)


def soup(seed: int, count: int, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Loose triangles in a unit box."""
    rng = np.random.default_rng(seed)
    corners = rng.random((count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def meets_exactly(a: list, b: list) -> bool:
    """Does an edge of one triangle meet the other? Rational numbers; triangles of different planes."""

    def orient(p, q, r, s):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (
            [u - v for u, v in zip(w, s, strict=True)] for w in (p, q, r)
        )
        return ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)

    for one, two in ((a, b), (b, a)):
        for i in range(3):
            p, q = one[i], one[(i + 1) % 3]
            if orient(*two, p) * orient(*two, q) > 0:
                continue
            turns = [orient(p, q, two[k], two[(k + 1) % 3]) for k in range(3)]
            if min(turns) >= 0 or max(turns) <= 0:
                return True
    return False


@settings(max_examples=12)
@given(SEEDS)
def test_every_pair_agrees_with_rational_arithmetic(seed):
    vertices, triangles = soup(seed, 16, 0.15)
    exact = [[[Fraction(float(x)) for x in vertices[i]] for i in t] for t in triangles]
    expected = [pair for pair in combinations(range(16), 2) if meets_exactly(*(exact[k] for k in pair))]
    assert [tuple(pair) for pair in crossing_pairs(vertices, triangles)] == expected


@pytest.mark.parametrize(("count", "size"), [(250, 0.05), (120, 0.15), (40, 0.6)])
def test_large_soups_agree_with_an_independent_library(count, size):
    vertices, triangles = soup(7, count, size)
    corner = vertices[triangles][:, :, None]
    low, high = corner.min(axis=1)[:, 0], corner.max(axis=1)[:, 0]
    expected = []
    for i, j in combinations(range(count), 2):
        if (low[i] <= high[j]).all() and (low[j] <= high[i]).all():
            ends = [np.ascontiguousarray(corner[k, c]) for k in (i, j) for c in range(3)]
            if igl.tri_tri_overlap_test_3d(*ends):
                expected.append((i, j))
    assert len(expected) > 20
    assert [tuple(pair) for pair in crossing_pairs(vertices, triangles)] == expected


@settings(max_examples=30)
@given(SEEDS)
def test_the_answer_does_not_depend_on_the_order_of_corners_and_triangles(seed):
    rng = np.random.default_rng(seed)
    vertices, triangles = soup(seed, 40, 0.2)
    order = rng.permutation(40)
    turned = np.array(
        [np.roll(t, k)[:: 1 if k else -1] for t, k in zip(triangles, rng.integers(0, 3, 40), strict=True)]
    )
    hit = crossing_triangles(vertices, triangles)
    np.testing.assert_array_equal(crossing_triangles(vertices, turned[order]), hit[order])


def hits(points, triangles) -> int:
    return len(crossing_pairs(np.array(points, float), np.array(triangles)))


BASE = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]


@pytest.mark.parametrize(
    ("name", "others", "triangle", "expected"),
    [
        ("a blade through the middle", [[1, 1, -1], [1, 1, 1], [9, 9, 0.5]], [3, 4, 5], 1),
        ("a blade beside it", [[5, 5, -1], [5, 5, 1], [9, 9, 0.5]], [3, 4, 5], 0),
        ("parallel above", [[0, 0, 1], [4, 0, 1], [0, 4, 1]], [3, 4, 5], 0),
        ("the tip touches from above", [[1, 1, 0], [1, 2, 3], [2, 1, 3]], [3, 4, 5], 1),
        ("over in the same plane", [[1, 1, 0], [9, 1, 0], [1, 9, 0]], [3, 4, 5], 1),
        ("beside in the same plane", [[5, 5, 0], [9, 5, 0], [5, 9, 0]], [3, 4, 5], 0),
        ("a corner in common, away", [[-3, -1, 2], [-1, -3, 2]], [0, 3, 4], 0),
        ("a corner in common, through", [[1, 2, -1], [2, 1, 1]], [0, 3, 4], 1),
        ("a corner in common, flat and apart", [[-3, 0, 0], [0, -3, 0]], [0, 3, 4], 0),
        ("a corner in common, flat and over", [[3, 1, 0], [1, 3, 0]], [0, 3, 4], 1),
        ("an edge in common, flat and apart", [[0, -3, 0]], [1, 0, 3], 0),
        ("an edge in common, any fold", [[1, 1, 1e-3]], [1, 0, 3], 0),
        ("an edge in common, folded shut", [[1, 2, 0]], [1, 0, 3], 1),
        ("the same triangle twice", [], [1, 2, 0], 1),
    ],
)
def test_cases_built_by_hand(name, others, triangle, expected):
    assert hits(BASE + others, [[0, 1, 2], triangle]) == expected, name


def test_a_closed_surface_is_clean_and_two_that_overlap_are_not():
    ball = trimesh.creation.icosphere(subdivisions=3)
    vertices, triangles = np.array(ball.vertices), np.array(ball.faces, np.int64)
    assert not crossing_triangles(vertices, triangles).any()
    both = np.concatenate([vertices, vertices + np.array([0.9, 0.13, 0.07])])
    hit = crossing_triangles(both, np.concatenate([triangles, triangles + len(vertices)]))
    centre = both[np.concatenate([triangles, triangles + len(vertices)])].mean(axis=1)[hit]
    assert hit.sum() > 30
    middle = np.array([0.9, 0.13, 0.07]) / 2
    off = (centre - middle) @ (middle / np.linalg.norm(middle))
    assert np.abs(off).max() < 0.2


def test_a_dent_pushed_through_the_other_side_is_found():
    tube = trimesh.creation.cylinder(radius=50.0, height=300.0, sections=48).subdivide().subdivide()
    vertices, triangles = np.array(tube.vertices), np.array(tube.faces, np.int64)
    assert not crossing_triangles(vertices, triangles).any()
    push = np.exp(-((vertices[:, 2] / 20.0) ** 2)) * (vertices[:, 0] > 0)
    dented = vertices - np.outer(push * 110.0, [1.0, 0.0, 0.0])
    hit = crossing_triangles(dented, triangles)
    assert hit.any()
    assert np.abs(dented[triangles[hit]].mean(axis=1)[:, 2]).max() < 60.0


def test_no_triangles_have_no_crossings():
    assert crossing_pairs(np.zeros((3, 3)), np.zeros((1, 3), np.int64)).shape == (0, 2)
