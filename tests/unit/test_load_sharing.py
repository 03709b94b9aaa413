"""The quadratic programme against closed forms, its optimality conditions and another solver."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from hilbrace.biomech.load_sharing import share_load
from hilbrace.errors import SolverError


def random_problem(seed: int, frames: int, rows: int, muscles: int, demand: float):
    """Muscles that reach few rows, rows of strengths far apart, demands up to beyond what muscles can."""
    random = np.random.default_rng(seed)
    reach = random.choice([0.0, 1.0, 30.0, 300.0], size=(1, rows, muscles), p=[0.6, 0.2, 0.1, 0.1])
    effect = random.normal(size=(frames, rows, muscles)) * reach
    wanted = random.normal(size=(frames, rows)) * demand
    return effect, wanted, random.choice([1.0, 100.0, 1700.0], size=rows), random.choice([0.0, 0.01], muscles)


def test_two_muscles_share_a_moment_by_their_effects():
    """Without a bound in the way and a weak reserve, a_m = effect_m * moment / sum effect^2."""
    shares = share_load(np.array([[[30.0, 40.0]]]), np.array([[20.0]]), np.array([1e-3]), np.zeros(2))
    assert np.allclose(shares.activation, [[30.0 * 20.0 / 2500.0, 40.0 * 20.0 / 2500.0]], atol=1e-7)


def test_the_reserve_takes_what_saturated_muscles_leave():
    shares = share_load(np.array([[[30.0, 40.0]]]), np.array([[200.0]]), np.array([1.0]), np.zeros(2))
    assert np.allclose(shares.activation, 1.0, atol=1e-9)
    assert shares.rest[0, 0] == pytest.approx(130.0, abs=1e-6)


def test_an_antagonist_rests_at_its_least_activation():
    shares = share_load(np.array([[[30.0, -40.0]]]), np.array([[10.0]]), np.array([1.0]), np.full(2, 0.01))
    assert shares.activation[0, 1] == pytest.approx(0.01, abs=1e-9)
    assert shares.activation[0, 0] > 10.0 / 30.0


def test_strong_rows_share_like_muscles():
    """A surface of strength s and a muscle of effect e meet a demand d: a = (e d / s^2) / (1 + (e / s)^2)."""
    effect, strength, demand = 500.0, 1000.0, 400.0
    shares = share_load(np.array([[[effect]]]), np.array([[demand]]), np.array([strength]), np.zeros(1))
    expected = (effect * demand / strength**2) / (1.0 + (effect / strength) ** 2)
    assert shares.activation[0, 0] == pytest.approx(expected, rel=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.1, 3.0, 50.0, 2000.0]))
def test_optimality_conditions(seed, demand):
    """Where an activation is inside its bounds the cost does not change with it; at bounds it would rise."""
    effect, wanted, strength, least = random_problem(seed, 6, 9, 25, demand)
    shares = share_load(effect, wanted, strength, least)
    a = shares.activation
    assert (a >= least).all()
    assert (a <= 1.0).all()
    assert np.allclose(shares.rest, wanted - np.einsum("frm,fm->fr", effect, a))
    slope = a - np.einsum("frm,fr->fm", effect, shares.rest / strength**2)
    size = 1.0 + np.abs(np.einsum("frm,fr->fm", effect, wanted / strength**2)).max(axis=1, keepdims=True)
    low, high = a - least < 1e-6, 1.0 - a < 1e-6
    assert (np.abs(slope[~low & ~high]) < 1e-6 * np.broadcast_to(size, a.shape)[~low & ~high]).all()
    assert (slope[low] > -1e-6 * np.broadcast_to(size, a.shape)[low]).all()
    assert (slope[high] < 1e-6 * np.broadcast_to(size, a.shape)[high]).all()


@pytest.mark.parametrize("demand", [1.0, 30.0, 1000.0])
def test_against_scipy(demand):
    effect, wanted, strength, least = random_problem(7, 5, 10, 40, demand)
    found = share_load(effect, wanted, strength, least)
    for frame in range(5):
        matrix = np.vstack([np.eye(40), effect[frame] / strength[:, None]])
        target = np.r_[np.zeros(40), wanted[frame] / strength]
        other = lsq_linear(matrix, target, bounds=(least, 1.0), tol=1e-13, max_iter=500)

        def cost(a, matrix=matrix, target=target):
            return ((matrix @ a - target) ** 2).sum()

        assert cost(found.activation[frame]) <= cost(other.x) * (1 + 1e-9) + 1e-12


def test_frames_do_not_touch_each_other():
    effect, wanted, strength, least = random_problem(3, 8, 6, 20, 20.0)
    together = share_load(effect, wanted, strength, least).activation
    alone = [
        share_load(effect[k : k + 1], wanted[k : k + 1], strength, least).activation[0] for k in range(8)
    ]
    assert np.allclose(together, alone, atol=1e-9)


def test_no_muscles_and_no_rows():
    none = share_load(np.zeros((3, 2, 0)), np.ones((3, 2)), np.ones(2), np.zeros(0))
    assert none.activation.shape == (3, 0)
    assert np.array_equal(none.rest, np.ones((3, 2)))
    free = share_load(np.zeros((3, 0, 4)), np.zeros((3, 0)), np.zeros(0), np.full(4, 0.01))
    assert np.allclose(free.activation, 0.01, atol=1e-6)


def test_gaps_are_refused_by_name():
    with pytest.raises(SolverError, match="not finite"):
        share_load(np.ones((1, 1, 1)), np.full((1, 1), np.nan), np.ones(1), np.zeros(1))
