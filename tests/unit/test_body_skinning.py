"""Skinning against rigid motions, closed forms of diffusion, and functions that subdivision reproduces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilbrace.body.body import Body
from hilbrace.body.skinning import bind, skin, smoothed_weights
from hilbrace.errors import GeometryError

SEEDS = st.integers(0, 10_000)


def sheet(columns: int, rows: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """A flat rectangle of triangles in the plane z = 0."""
    x, y = np.meshgrid(np.arange(columns) * step, np.arange(rows) * step)
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.column_stack([corner, corner + 1, corner + columns])
    upper = np.column_stack([corner + 1, corner + columns + 1, corner + columns])
    return vertices, np.concatenate([lower, upper])


def body_of_sheet(vertices: np.ndarray, triangles: np.ndarray, weights: np.ndarray) -> Body:
    bones = tuple(f"bone{k}" for k in range(weights.shape[1]))
    none = np.zeros((0, 3))
    figures = {"mass_kg": 70.0, "height_m": 1.7, "height_error_mm": 0.0}
    return Body(
        model="sheet",
        scaled_bodies=(),
        segment_scales=none,
        shape=np.zeros(0),
        vertices=vertices,
        triangles=triangles,
        bones=bones,
        bone_weights=weights,
        joint_names=(),
        joint_centres=none,
        fit_error_mm=np.zeros(0),
        **figures,
    )


def random_scene(seed: int, frames: int = 3, bones: int = 4, points: int = 20):
    rng = np.random.default_rng(seed)
    weights = rng.random((points, bones))
    turns = Rotation.random(frames * bones, rng=rng).as_matrix().reshape(frames, bones, 3, 3)
    return (
        rng.normal(size=(points, 3)),
        weights / weights.sum(axis=1, keepdims=True),
        turns,
        rng.normal(size=(frames, bones, 3)),
    )


@given(SEEDS)
def test_points_of_one_bone_move_with_it(seed):
    points, weights, turns, shifts = random_scene(seed)
    weights = np.eye(4)[weights.argmax(axis=1)]
    bone = weights.argmax(axis=1)
    expected = np.einsum("fpij,pj->fpi", turns[:, bone], points) + shifts[:, bone]
    np.testing.assert_allclose(skin(points, weights, turns, shifts), expected, atol=1e-12)


@given(SEEDS)
def test_bones_that_move_together_carry_the_skin_rigidly(seed):
    points, weights, turns, shifts = random_scene(seed)
    turns, shifts = np.repeat(turns[:, :1], 4, axis=1), np.repeat(shifts[:, :1], 4, axis=1)
    expected = points @ np.swapaxes(turns[:, 0], 1, 2) + shifts[:, :1]
    np.testing.assert_allclose(skin(points, weights, turns, shifts), expected, atol=1e-12)


@given(SEEDS)
def test_a_motion_of_the_whole_body_moves_the_posed_skin(seed):
    rng = np.random.default_rng([seed, 1])
    points, weights, turns, shifts = random_scene(seed)
    turns[:] = (Rotation.from_rotvec(rng.normal(0.0, 0.5, (12, 3)))).as_matrix().reshape(turns.shape)
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    posed = skin(points, weights, turns, shifts) @ turn.T + shift
    moved = skin(points, weights, turn @ turns, shifts @ turn.T + shift)
    np.testing.assert_allclose(moved, posed, atol=1e-10)


@pytest.mark.parametrize("degrees", [20.0, 90.0, 170.0])
def test_half_way_between_two_turns_about_one_axis_is_half_the_turn(degrees):
    points = np.random.default_rng(0).normal(size=(6, 3))
    turns = Rotation.from_euler("z", [[0.0], [degrees]], degrees=True).as_matrix()[None]
    halved = skin(points, np.full((6, 2), 0.5), turns, np.zeros((1, 2, 3)))[0]
    expected = Rotation.from_euler("z", degrees / 2, degrees=True).apply(points)
    np.testing.assert_allclose(halved, expected, atol=1e-12)


def test_shifts_alone_blend_linearly():
    points, weights, _, shifts = random_scene(3)
    still = np.broadcast_to(np.eye(3), (3, 4, 3, 3))
    np.testing.assert_allclose(skin(points, weights, still, shifts), points + weights @ shifts, atol=1e-12)


def test_a_step_in_the_weights_diffuses_into_exponentials():
    vertices, triangles = sheet(161, 7, 0.005)
    step = (vertices[:, 0] > 0.4).astype(float)
    step[np.isclose(vertices[:, 0], 0.4)] = 0.5
    length = 0.04
    smooth = smoothed_weights(vertices, triangles, np.column_stack([step, 1 - step]), length)
    x = vertices[:, 0] - 0.4
    expected = np.where(x > 0, 1 - np.exp(-np.abs(x) / length) / 2, np.exp(-np.abs(x) / length) / 2)
    np.testing.assert_allclose(smooth[:, 0], expected, atol=2e-3)
    np.testing.assert_allclose(smooth.sum(axis=1), 1.0, atol=1e-14)


def test_no_smoothing_leaves_weights_as_they_are():
    vertices, triangles = sheet(5, 5, 0.1)
    weights = np.random.default_rng(0).dirichlet(np.ones(3), len(vertices))
    np.testing.assert_allclose(smoothed_weights(vertices, triangles, weights, 0.0), weights, atol=1e-15)


def test_smoothing_refuses_triangles_without_area():
    vertices, triangles = sheet(4, 4, 0.1)
    vertices[5] = vertices[6]
    with pytest.raises(GeometryError, match="smoothed"):
        smoothed_weights(vertices, triangles, np.eye(16)[:, :2] + 1e-3, 0.04)


def test_bound_points_read_linear_weights_exactly():
    vertices, triangles = sheet(21, 21, 0.01)
    share = vertices[:, 0] / 0.2
    body = body_of_sheet(vertices, triangles, np.column_stack([share, 1 - share]))
    points = np.random.default_rng(1).uniform(0.06, 0.14, (50, 3)) * [1, 1, 0] + [0, 0, 0.002]
    weights = bind(points, body)
    np.testing.assert_allclose(weights[:, 0], points[:, 0] / 0.2, atol=1e-12)


def test_bound_weights_are_smoother_than_interpolation_in_the_coarse_triangles():
    vertices, triangles = sheet(21, 21, 0.02)
    share = 1 / (1 + np.exp(-(vertices[:, 0] - 0.2) / 0.02))
    body = body_of_sheet(vertices, triangles, np.column_stack([share, 1 - share]))
    x = np.linspace(0.12, 0.28, 161)
    weights = bind(np.column_stack([x, np.full_like(x, 0.203), np.zeros_like(x)]), body)[:, 0]
    coarse = np.interp(x, vertices[:21, 0], share[:21])
    kink, coarse_kink = (np.abs(np.diff(w, 2)).max() for w in (weights, coarse))
    assert kink < 0.5 * coarse_kink
