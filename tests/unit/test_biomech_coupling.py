"""Stiffness and damping of a joint, against closed forms and properties of matrices."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.biomech.coupling import (
    DAMPING_RATIO,
    muscle_stiffness,
    nearest_semidefinite,
    proportional_damping,
    short_range_stiffness,
)
from tests.unit.knee_tube import knee_loads


def _definite(seed: int, size: float) -> np.ndarray:
    root = np.random.default_rng(seed).standard_normal((4, 3, 3))
    return size * (root @ root.transpose(0, 2, 1) + 0.2 * np.eye(3))


def test_short_range_stiffness_is_two_springs_in_series():
    pull, most, fibre, tendon = np.array([[500.0]]), np.array([1000.0]), np.array([0.08]), np.array([0.2])
    expected = 1.0 / (0.08 / (23.4 * 500.0) + 0.2 / (1.375 / 0.049 * 500.0))
    np.testing.assert_allclose(short_range_stiffness(pull, most, fibre, tendon), [[expected]])


def test_an_idle_muscle_adds_nothing_and_a_tendon_that_cannot_stretch_leaves_the_fibres():
    most, fibre, tendon = np.array([1000.0]), np.array([0.08]), np.array([0.2])
    assert short_range_stiffness(np.array([[0.0]]), most, fibre, tendon)[0, 0] == 0.0
    stiff = short_range_stiffness(np.array([[500.0]]), most, fibre, np.array([1e-12]))
    np.testing.assert_allclose(stiff, 23.4 * 500.0 / 0.08, rtol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 1.0))
def test_every_mode_has_the_damping_ratio(seed, ratio):
    """``C`` is diagonal in the modes of (K, M), with ``2 ratio omega`` each; scipy's modes are the oracle."""
    mass, spring = _definite(seed, 0.1), _definite(seed + 1, 100.0)
    drag = proportional_damping(mass, spring, ratio)
    for m, k, c in zip(mass, spring, drag, strict=True):
        squared, modes = scipy.linalg.eigh(k, m)
        expected = np.diag(2 * ratio * np.sqrt(squared))
        np.testing.assert_allclose(modes.T @ c @ modes, expected, atol=1e-7 * expected.max())


def test_the_damping_of_one_axis_is_the_textbook_one():
    mass, spring = np.diag([0.4, 0.3, 0.02])[None], np.diag([30.0, 280.0, 80.0])[None]
    expected = np.diag(2 * DAMPING_RATIO * np.sqrt([0.4 * 30.0, 0.3 * 280.0, 0.02 * 80.0]))
    np.testing.assert_allclose(proportional_damping(mass, spring)[0], expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_the_nearest_semidefinite_matrix_is_one_and_no_farther_than_others(seed):
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((1, 3, 3))
    matrix = matrix + matrix.transpose(0, 2, 1)
    near = nearest_semidefinite(matrix)[0]
    assert np.linalg.eigvalsh(near).min() > -1e-12
    root = rng.standard_normal((3, 3))
    other = near + 0.1 * (root @ root.T - near)
    assert np.linalg.norm(near - matrix[0]) <= np.linalg.norm(other - matrix[0]) + 1e-12
    definite = _definite(seed, 1.0)
    np.testing.assert_allclose(nearest_semidefinite(definite), definite, rtol=1e-9, atol=1e-12)


def test_a_joint_without_muscles_has_no_muscle_stiffness():
    assert not muscle_stiffness(knee_loads(), "knee_r").any()
