"""The field of several layers: exact gradients, closed around the limb, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hilbrace.config import OptimizeSettings
from hilbrace.errors import GeometryError
from hilbrace.field import Field, GaussianField, NetworkField, build_field

PERIOD = 0.83


def points(count=60, seed=0):
    return np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2))


def network(uv=None, period=PERIOD, layers=(8, 7), waves=3):
    return NetworkField(points() if uv is None else uv, layers, waves, period)


def test_the_gradient_matches_finite_differences():
    field = network(points(12), layers=(5, 4), waves=2)
    theta = field.start(1, 0.5).requires_grad_()
    assert torch.autograd.gradcheck(field.logits, theta, eps=1e-3, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("turns", [-1, 1, 3])
def test_it_closes_around_the_limb_with_its_slope(turns):
    uv = points()
    theta = network().start(2, 1.0)
    for shift in (0.0, 1e-4):
        here = network(uv + np.array([shift, 0.0])).logits(theta)
        there = network(uv + np.array([turns * PERIOD + shift, 0.0])).logits(theta)
        torch.testing.assert_close(there, here, rtol=0, atol=1e-11)


def test_a_map_that_is_cut_does_not_close():
    uv = np.array([[0.0, 0.5], [1.0, 0.5]])
    field = network(uv, period=0.0)
    ends = field.logits(field.start(2, 1.0))
    assert abs(float(ends[0] - ends[1])) > 1e-2


def test_it_is_the_network_written_out():
    uv, field = points(), network(layers=(3,), waves=1)
    theta = field.start(3, 1.0)
    w = 0.03 * theta.numpy()
    hidden, offset, last = w[:12].reshape(3, 4), w[12:15], w[15:18]
    u, v = 2 * np.pi * uv[:, 0] / PERIOD, np.pi * uv[:, 1]
    features = np.stack([np.cos(u), np.sin(u), np.cos(v), np.sin(v)])
    expected = last @ np.tanh(hidden @ features + offset[:, None]) + w[18]
    np.testing.assert_allclose(field.logits(theta, 7.0).numpy(), 7.0 * expected, rtol=1e-12, atol=1e-14)
    assert field.parameters == len(theta) == 19


def test_it_is_the_same_whatever_points_it_is_asked_with():
    theta = network().start(4, 1.0)
    whole, part = network().logits(theta), network(points()[20:]).logits(theta)
    torch.testing.assert_close(part, whole[20:], rtol=0, atol=1e-13)


def test_the_start_is_seeded_and_as_uneven_as_asked():
    field = network(points(4000), layers=(32, 32), waves=6)
    assert torch.equal(field.start(5, 0.1), field.start(5, 0.1))
    assert not torch.equal(field.start(5, 0.1), field.start(6, 0.1))
    spreads = [float(field.logits(field.start(seed, 0.1), 1.0).std()) for seed in range(20)]
    assert 0.02 < np.mean(spreads) < 0.2
    assert float(field.logits(field.start(5, 0.0)).abs().max()) == 0.0


def test_its_neurons_can_tell_the_places_of_the_map_apart():
    """Sixty steps of Adam bring it near a spot that no single wave is."""
    uv = points(600)
    spot = torch.from_numpy(np.exp(-40.0 * ((uv - [0.4, 0.6]) ** 2).sum(axis=1)))
    field = network(uv, layers=(32, 32), waves=6)
    theta = field.start(0, 0.02).requires_grad_()
    optimizer = torch.optim.Adam([theta], lr=0.3)
    for _ in range(60):
        optimizer.zero_grad()
        loss = ((field.logits(theta, 2.0) - spot) ** 2).mean()
        loss.backward()
        optimizer.step()
    assert loss.item() < 0.1 * spot.var().item()


@pytest.mark.parametrize("point", [[0.3, 1.2], [0.3, -0.1], [np.nan, 0.5]])
def test_points_outside_the_map_are_refused(point):
    with pytest.raises(GeometryError, match="point 1"):
        network(np.array([[0.5, 0.5], point]))


@pytest.mark.parametrize(("kind", "made"), [("gaussian", GaussianField), ("network", NetworkField)])
def test_both_kinds_keep_one_protocol(kind, made):
    settings = OptimizeSettings(field=kind, sigma=4.0, network_layers=(6,), network_waves=2)
    field: Field = build_field(points(), settings, 0.0)
    assert isinstance(field, made)
    logits = field.logits(field.start(0, 0.02), 2.0)
    assert logits.shape == (60,)
    assert float(logits.std()) < 0.1
    assert torch.isfinite(logits).all()
