"""Quaternions against scipy's rotations; dual quaternions against the rigid motions they stand for."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hilbrace.body import quaternions

SEEDS = st.integers(0, 10_000)


@given(SEEDS)
def test_product_composes_rotations(seed):
    left, right = (Rotation.random(5, rng=np.random.default_rng([seed, k])) for k in range(2))
    ours = quaternions.product(left.as_quat(), right.as_quat())
    both = (left * right).as_quat()
    np.testing.assert_allclose(np.abs((ours * both).sum(axis=1)), 1.0, atol=1e-12)


def test_from_matrices_keeps_leading_axes():
    turn = Rotation.from_euler("z", [[30.0], [90.0]], degrees=True).as_matrix()[:, None]
    ours = quaternions.from_matrices(turn)
    assert ours.shape == (2, 1, 4)
    np.testing.assert_allclose(np.abs(ours[1, 0]), [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-15)


@given(SEEDS, st.floats(0.2, 5.0), st.sampled_from([1.0, -1.0]))
def test_dual_quaternion_moves_points_rigidly_whatever_its_norm_and_sign(seed, norm, sign):
    rng = np.random.default_rng(seed)
    turn, shift, points = Rotation.random(rng=rng), rng.normal(size=3), rng.normal(size=(7, 3))
    real = turn.as_quat()
    dual = quaternions.dual_parts(real, shift)
    moved = quaternions.move(*(np.tile(sign * norm * part, (1, 7, 1)) for part in (real, dual)), points)
    np.testing.assert_allclose(moved[0], turn.apply(points) + shift, atol=1e-12)
