"""Surfaces that make no shell are refused by the element, edge or vertex at fault, and good ones are not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import GeometryError, HilbraceError, SolverError
from hilbrace.shell import build_shell
from hilbrace.shell.directors import nodal_directors
from hilbrace.shell.element import element_stiffness
from hilbrace.shell.mesh_checks import check_shape, check_surface, check_thickness
from hilbrace.shell.section import isotropic
from tests.unit.shell_cases import grid, tube

VERTICES, TRIANGLES, UPPER, LOWER = tube(12, 9, 30.0, 80.0, waviness=0.1, window=True)
GOOD = (VERTICES, TRIANGLES, UPPER, LOWER)
SIDES = np.sort(np.stack([TRIANGLES, np.roll(TRIANGLES, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
BOUNDARY = [
    side for side, count in zip(*np.unique(SIDES, axis=0, return_counts=True), strict=True) if count == 1
]
WINDOW = np.setdiff1d(np.array(BOUNDARY), np.concatenate([UPPER, LOWER]))
INSIDE = np.setdiff1d(np.arange(len(VERTICES)), np.array(BOUNDARY))
DEEP = np.flatnonzero(np.isin(TRIANGLES, INSIDE).all(axis=1))
"""Triangles away from all boundaries."""


@st.composite
def good_tube(draw):
    columns, rows = draw(st.integers(3, 14)), draw(st.integers(2, 10))
    return tube(columns, rows, 30.0, draw(st.floats(20.0, 200.0)), draw(st.floats(0.0, 0.2)))


@settings(max_examples=40, deadline=None)
@given(good_tube(), st.integers(0, 1000))
def test_good_surfaces_pass_in_any_order_of_triangles_corners_and_loops(surface, seed):
    vertices, triangles, upper, lower = surface
    rng = np.random.default_rng(seed)
    shuffled = np.take_along_axis(
        triangles, (np.arange(3) + rng.integers(3, size=(len(triangles), 1))) % 3, 1
    )
    check_surface(vertices, rng.permutation(shuffled), rng.permutation(upper), rng.permutation(lower))


def test_window_is_welcome():
    assert len(WINDOW) > 3
    check_surface(*GOOD)


def test_all_triangles_facing_inwards_are_a_shell_too():
    check_surface(VERTICES, TRIANGLES[:, ::-1], UPPER, LOWER)


# --- one fault in a good mesh: the message must name it

TRIANGLE = st.sampled_from(range(len(TRIANGLES)))
DEEP_TRIANGLE = st.sampled_from(DEEP.tolist())
CORNER = st.integers(0, 2)


def refusal(vertices, triangles, upper=UPPER, lower=LOWER, kind=GeometryError):
    with pytest.raises(HilbraceError) as caught:
        check_surface(vertices, triangles, upper, lower)
    assert type(caught.value) is kind
    assert caught.value.hint
    return f"{caught.value.what} at {caught.value.where}."


def replaced(array, index, value):
    changed = array.copy()
    changed[index] = value
    return changed


@given(TRIANGLE, CORNER, st.sampled_from([-1, len(VERTICES), 10**6]))
def test_index_that_leads_nowhere(triangle, corner, index):
    message = refusal(VERTICES, replaced(TRIANGLES, (triangle, corner), index))
    assert f"triangle {triangle}: vertex {index}" in message


@given(st.integers(0, len(UPPER) - 1))
def test_loop_index_that_leads_nowhere(entry):
    message = refusal(VERTICES, TRIANGLES, upper=replaced(UPPER, entry, len(VERTICES)))
    assert f"upper loop entry {entry}: vertex {len(VERTICES)}" in message


@given(TRIANGLE, CORNER)
def test_doubled_triangle(triangle, roll):
    again = np.roll(TRIANGLES[triangle], roll)
    message = refusal(VERTICES, np.vstack([TRIANGLES, again]))
    assert f"triangle {len(TRIANGLES)} repeats triangle {triangle}." in message
    turned = refusal(VERTICES, np.vstack([TRIANGLES, again[::-1]]))
    assert f"repeats triangle {triangle}." in turned


@given(DEEP_TRIANGLE)
def test_inverted_triangle(triangle):
    message = refusal(VERTICES, replaced(TRIANGLES, triangle, TRIANGLES[triangle, ::-1]))
    assert f"triangle {triangle} against its neighbour" in message
    assert message.startswith("3 edges")


@given(TRIANGLE)
def test_inverted_triangle_at_a_boundary_is_named_with_its_neighbour(triangle):
    message = refusal(VERTICES, replaced(TRIANGLES, triangle, TRIANGLES[triangle, ::-1]))
    assert f"{triangle} against" in message or f"neighbour {triangle}." in message


@given(TRIANGLE, CORNER)
def test_collapsed_triangle(triangle, corner):
    message = refusal(VERTICES, replaced(TRIANGLES, (triangle, corner), TRIANGLES[triangle, corner - 1]))
    assert f"triangle {triangle} of the shell" in message
    assert "twice" in message


@given(DEEP_TRIANGLE, st.floats(0.0, 2e-4))
def test_needle(triangle, height):
    a, b, c = TRIANGLES[triangle]
    flat = VERTICES[a] + 0.4 * (VERTICES[b] - VERTICES[a])
    moved = replaced(VERTICES, c, flat + height * (VERTICES[c] - flat))
    first = int(refusal(moved, TRIANGLES).split("triangle ")[-1].split()[0])
    assert c in TRIANGLES[first]
    assert first <= triangle


@given(st.sampled_from(range(len(VERTICES))), CORNER, st.sampled_from([np.nan, np.inf, -np.inf]))
def test_lost_position(vertex, axis, value):
    message = refusal(replaced(VERTICES, (vertex, axis), value), TRIANGLES)
    assert f"at vertex {vertex} of" in message


@given(DEEP_TRIANGLE, CORNER)
def test_fin_on_an_edge(triangle, corner):
    a, b = TRIANGLES[triangle, corner], TRIANGLES[triangle, corner - 1]
    tip = 1.3 * VERTICES[[a, b]].mean(axis=0)
    message = refusal(np.vstack([VERTICES, tip]), np.vstack([TRIANGLES, [a, b, len(VERTICES)]]))
    assert f"edge from vertex {min(a, b)} to {max(a, b)}" in message
    assert f"{triangle}," in message
    assert f", {len(TRIANGLES)}." in message


@given(st.integers(0, len(VERTICES)))
def test_vertex_without_triangles(place):
    vertices = np.insert(VERTICES, place, [1.0, 2.0, 3.0], axis=0)
    triangles, upper, lower = (part + (part >= place) for part in (TRIANGLES, UPPER, LOWER))
    assert f"at vertex {place} of" in refusal(vertices, triangles, upper, lower, kind=SolverError)


@given(st.integers(0, len(TRIANGLES)), st.booleans())
def test_piece_that_hangs_on_nothing_or_on_one_vertex(place, on_vertex):
    island = VERTICES[INSIDE[0]] * 1.1 + np.array([[0.0, 0, 0], [5, 0, 0], [0, 0, 5.0]])
    piece = len(VERTICES) + np.arange(3)
    vertices = np.vstack([VERTICES, island])
    if on_vertex:
        piece[0] = INSIDE[0]
        vertices = np.delete(vertices, len(VERTICES), axis=0)
        piece[1:] -= 1
    message = refusal(vertices, np.insert(TRIANGLES, place, piece, axis=0), kind=SolverError)
    assert "2 pieces" in message
    assert f"at triangle {place} of" in message


@given(st.integers(0, len(LOWER) - 1))
def test_loop_with_a_vertex_left_out_is_not_closed(gap):
    message = refusal(VERTICES, TRIANGLES, lower=np.delete(LOWER, gap))
    assert "lower loop is not closed: 2" in message
    neighbours = {LOWER[gap - 1], LOWER[(gap + 1) % len(LOWER)]}
    assert int(message.split("vertex ")[1].split()[0]) in neighbours


@given(st.sampled_from(INSIDE.tolist()))
def test_loop_with_a_vertex_off_the_boundary(vertex):
    message = refusal(VERTICES, TRIANGLES, upper=np.append(UPPER, vertex))
    assert f"at vertex {vertex} of the shell, no boundary edges" in message


def test_loop_along_two_boundaries():
    message = refusal(VERTICES, TRIANGLES, upper=np.append(UPPER, WINDOW))
    assert "upper loop runs along more than one boundary" in message
    assert f"vertex {WINDOW[0]} lies" in message


def test_surface_that_is_cut_open_has_no_closed_loops():
    u, v, triangles = grid(12, 6, rising=True)
    angle = 2 * np.pi * u * 0.999
    vertices = np.stack([30 * np.cos(angle), 80 * v, 30 * np.sin(angle)], axis=1)
    message = refusal(vertices, triangles, np.flatnonzero(v == 1), np.flatnonzero(v == 0))
    assert "upper loop is not closed: 2" in message


@given(st.integers(0, len(LOWER) - 1))
def test_loops_that_share_or_repeat_a_vertex(entry):
    assert "both loops" in refusal(VERTICES, TRIANGLES, upper=replaced(UPPER, 0, LOWER[entry]))
    assert "lower loop is no loop" in refusal(VERTICES, TRIANGLES, lower=np.append(LOWER, LOWER[entry]))


@given(TRIANGLE, st.sampled_from([0.0, -1.0, np.nan, np.inf]))
def test_thickness_that_is_none(triangle, value):
    with pytest.raises(GeometryError, match=rf"triangle {triangle}, thickness"):
        check_thickness(replaced(np.full(len(TRIANGLES), 4.0), triangle, value))


# --- shapes that only the director shows


@given(st.sampled_from(INSIDE.tolist()))
def test_spike_is_no_smooth_wall(vertex):
    spiked = replaced(VERTICES, vertex, 4.0 * VERTICES[vertex])
    check_shape(spiked, TRIANGLES)
    with pytest.raises(GeometryError, match="steeper than 78 degrees") as caught:
        nodal_directors(spiked, TRIANGLES)
    named = int(caught.value.where.split()[1])
    around = np.isin(TRIANGLES, TRIANGLES[(TRIANGLES == vertex).any(axis=1)]).any(axis=1)
    assert around[named]


@pytest.mark.parametrize(("opening", "accepted"), [(60.0, True), (24.0, True), (22.0, False), (5.0, False)])
def test_crease_is_refused_where_its_sides_come_near_each_other(opening, accepted):
    # A strip folded along its middle: each side stands at half the opening to the plane of symmetry.
    u, v, triangles = grid(2, 4, rising=True)
    half = np.deg2rad(opening) / 2
    across = 2 * u - 1
    folded = np.stack([np.abs(across) * np.cos(half), v, -across * np.sin(half)], axis=1)
    if accepted:
        assert np.isfinite(nodal_directors(folded, triangles)).all()
    else:
        with pytest.raises(GeometryError, match="steeper than 78 degrees"):
            nodal_directors(folded, triangles)


@settings(max_examples=30)
@given(DEEP_TRIANGLE)
def test_wall_thicker_than_its_bend_allows_is_refused_by_triangle(triangle):
    directors = nodal_directors(VERTICES, TRIANGLES)[TRIANGLES]
    tangents = np.zeros((len(TRIANGLES), 3, 2, 3))
    tangents[..., 0, 0] = tangents[..., 1, 1] = 1.0
    thickness = replaced(np.full(len(TRIANGLES), 4.0), triangle, 200.0)
    with pytest.raises(GeometryError, match=f"triangle {triangle} of the shell"):
        element_stiffness(VERTICES[TRIANGLES], directors, tangents, thickness, isotropic(0.3))


# --- and the door that users go through


@pytest.mark.parametrize(
    ("surface", "named"),
    [
        ((VERTICES, np.vstack([TRIANGLES, TRIANGLES[7]]), UPPER, LOWER), "repeats triangle 7"),
        ((VERTICES, TRIANGLES, UPPER[:-1], LOWER), "upper loop is not closed"),
        (
            (VERTICES, replaced(TRIANGLES, DEEP[3], TRIANGLES[DEEP[3], ::-1]), UPPER, LOWER),
            f"triangle {DEEP[3]}",
        ),
    ],
)
def test_building_a_shell_checks_its_surface(surface, named):
    with pytest.raises(GeometryError, match=named):
        build_shell(*surface, 4.0, 0.45)
