"""The Gaussian field: the paper's sum, its hyperplane, and an evaluation that is right to ten digits."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import GeometryError
from hilbrace.field import GaussianField, hyperplane_weights, initial_parameters
from hilbrace.field.gaussian import neuron_row


def points(count=300, seed=0):
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2))


def dense_field(uv, sigma, theta):
    """The paper's sum over all neurons, written out."""
    size = len(theta)
    centres = np.linspace(0.0, 1.0, size)
    weights = theta.numpy() - theta.numpy().mean() + 1.0 / size**2
    near = (uv[:, 0, None, None] - centres[:, None]) ** 2 + (uv[:, 1, None, None] - centres[None, :]) ** 2
    return (weights * np.exp(-(sigma**2) * near)).sum(axis=(1, 2))


@pytest.mark.parametrize("sigma", [1.0, 4.0, 10.0, 20.0, 60.0])
def test_low_rank_evaluation_equals_the_papers_sum(sigma):
    uv = np.vstack([points(), [[0, 0], [1, 1], [0, 1]]])
    theta = initial_parameters(seed=1, spread=1.0)
    expected = dense_field(uv, sigma, theta)
    ours = GaussianField(uv, sigma).evaluate(theta).numpy()
    np.testing.assert_allclose(ours, expected, atol=1e-10 * np.abs(expected).max())


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.floats(0.5, 40.0), st.integers(2, 30))
def test_low_rank_evaluation_holds_for_any_layer(seed, sigma, size):
    uv, theta = points(40, seed), initial_parameters(size, seed, 1.0)
    expected = dense_field(uv, sigma, theta)
    ours = GaussianField(uv, sigma, size).evaluate(theta).numpy()
    np.testing.assert_allclose(ours, expected, atol=1e-10 * max(np.abs(expected).max(), 1.0))


def test_gradient_equals_that_of_the_dense_sum():
    uv, theta = points(), initial_parameters(seed=2, spread=1.0).requires_grad_()
    pull = torch.from_numpy(np.random.default_rng(3).standard_normal(len(uv)))
    (ours,) = torch.autograd.grad(pull @ GaussianField(uv, 10.0).evaluate(theta), theta)
    rows = [neuron_row(uv[:, axis], 10.0, 100, 0.0) for axis in range(2)]
    dense = rows[0].T @ (pull.numpy()[:, None] * rows[1])
    expected = dense - dense.mean()
    np.testing.assert_allclose(ours.numpy(), expected, atol=1e-10 * np.abs(expected).max())


def test_gradient_matches_finite_differences():
    field, theta = GaussianField(points(30), 6.0, size=5), initial_parameters(5, 4, 0.3)
    assert torch.autograd.gradcheck(field.evaluate, theta.requires_grad_(), eps=1e-4, rtol=1e-7, atol=1e-9)


@given(st.integers(0, 1000), st.floats(0.0, 100.0))
def test_weights_stay_on_the_hyperplane(seed, spread):
    weights = hyperplane_weights(initial_parameters(20, seed, spread))
    assert weights.sum().item() == pytest.approx(1.0, abs=1e-11 * max(1.0, spread))


def test_zero_parameters_give_equal_weights():
    assert np.array_equal(hyperplane_weights(initial_parameters()).numpy(), np.full((100, 100), 1e-4))


def test_start_is_uniform_in_the_units_of_the_projection():
    logits = GaussianField(points(), 4.0).logits(initial_parameters()).numpy()
    assert np.ptp(logits) < 1e-3


def test_a_smooth_change_of_parameters_moves_the_logit_by_the_contrast():
    bump = torch.zeros(100, 100, dtype=torch.float64)
    bump[20:80, 20:80] = 1.0
    middle = np.array([[0.5, 0.5]])
    for sigma in (10.0, 20.0):
        field = GaussianField(middle, sigma)
        moved = field.logits(bump, contrast=7.0) - field.logits(0 * bump, contrast=7.0)
        assert moved.item() == pytest.approx(7.0 * (1 - bump.mean().item()), rel=1e-3)


def test_neuron_sum_is_the_integral_of_a_gaussian_times_the_density():
    assert GaussianField(points(5), 20.0).neuron_sum == pytest.approx(99**2 * np.pi / 20.0**2, rel=1e-9)
    assert GaussianField(points(5), 20.0, period_u=0.8).neuron_sum == pytest.approx(
        100 / 0.8 * 99 * np.pi / 20.0**2, rel=1e-9
    )


@pytest.mark.parametrize(("sigma", "period"), [(1.0, 0.7), (4.0, 1.0), (10.0, 0.83)])
def test_periodic_field_closes_around_the_limb(sigma, period):
    uv = points()
    theta = initial_parameters(seed=6, spread=1.0)
    here = GaussianField(uv, sigma, period_u=period).evaluate(theta)
    for turns in (-1, 1, 3):
        there = GaussianField(uv + np.array([turns * period, 0.0]), sigma, period_u=period).evaluate(theta)
        torch.testing.assert_close(there, here, rtol=0, atol=1e-12 * here.abs().max().item())


def test_periodic_field_is_the_sum_over_all_images():
    uv, theta, period = points(50), initial_parameters(30, 7, 1.0), 0.6
    centres = np.arange(30) * (period / 30)
    images = sum(
        np.exp(-((5.0 * (uv[:, 0, None] - centres + shift * period)) ** 2)) for shift in range(-12, 13)
    )
    expected = ((images @ hyperplane_weights(theta).numpy()) * neuron_row(uv[:, 1], 5.0, 30, 0.0)).sum(axis=1)
    ours = GaussianField(uv, 5.0, 30, period).evaluate(theta).numpy()
    np.testing.assert_allclose(ours, expected, atol=1e-10 * np.abs(expected).max())


def test_field_is_the_same_whatever_points_it_is_asked_with():
    uv, theta = points(), initial_parameters(seed=8, spread=1.0)
    whole = GaussianField(uv, 10.0).evaluate(theta)
    part = GaussianField(uv[100:], 10.0).evaluate(theta)
    torch.testing.assert_close(part, whole[100:], rtol=0, atol=1e-12 * whole.abs().max().item())


def test_start_is_seeded():
    assert np.array_equal(initial_parameters(seed=3, spread=1.0), initial_parameters(seed=3, spread=1.0))
    assert not np.array_equal(initial_parameters(seed=3, spread=1.0), initial_parameters(seed=4, spread=1.0))


@pytest.mark.parametrize("point", [[1.2, 0.5], [0.5, -0.1], [np.nan, 0.5]])
def test_points_outside_the_map_are_refused(point):
    with pytest.raises(GeometryError, match="point 1"):
        GaussianField(np.array([[0.5, 0.5], point]), 4.0)
