"""Projection of the field onto an exact volume, and its implicit derivatives."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.errors import SolverError
from hilbrace.field import project, project_to_volume

AREAS = torch.from_numpy(np.random.default_rng(0).uniform(0.5, 2.0, 40))


def some_logits(seed=1, spread=3.0):
    return torch.from_numpy(spread * np.random.default_rng(seed).standard_normal(40))


def fraction(d):
    """A curved volume fraction, as a microstructure has: 0.1 to 0.65."""
    return (AREAS * (0.1 + 0.4 * d + 0.15 * d**3)).sum() / AREAS.sum()


@settings(deadline=None)
@given(st.integers(0, 1000), st.floats(0.0, 50.0), st.floats(0.11, 0.64))
def test_volume_is_met_exactly_and_d_stays_in_range(seed, spread, target):
    d, bias = project_to_volume(some_logits(seed, spread), fraction, target)
    assert fraction(d).item() == pytest.approx(target, abs=1e-13)
    assert ((d >= 0) & (d <= 1)).all()
    assert np.isfinite(bias.item())


def test_uniform_field_stays_uniform():
    d, _ = project_to_volume(torch.full((40,), 0.37, dtype=torch.float64), fraction, 0.3)
    assert np.ptp(d.numpy()) == 0.0


def test_adding_a_constant_changes_nothing():
    d, bias = project_to_volume(some_logits(), fraction, 0.4)
    shifted, moved = project_to_volume(some_logits() + 5.0, fraction, 0.4)
    torch.testing.assert_close(shifted, d, rtol=1e-12, atol=1e-14)
    assert moved.item() == pytest.approx(bias.item() - 5.0, abs=1e-11)


def test_bias_projects_the_field_elsewhere():
    d, bias = project_to_volume(some_logits(), fraction, 0.4)
    torch.testing.assert_close(project(some_logits()[:7], bias), d[:7], rtol=0, atol=0)


def test_derivatives_match_finite_differences():
    def both(logits):
        d, bias = project_to_volume(logits, fraction, 0.4)
        return torch.cat([d, bias.reshape(1)])

    assert torch.autograd.gradcheck(both, some_logits().requires_grad_(), eps=1e-5, rtol=1e-7, atol=1e-9)


def test_volume_has_no_gradient_left():
    logits = some_logits().requires_grad_()
    d, _ = project_to_volume(logits, fraction, 0.4)
    (gradient,) = torch.autograd.grad(fraction(d), logits)
    assert gradient.abs().max() < 1e-16


def test_derivative_by_what_the_volume_itself_depends_on():
    firm = torch.from_numpy(np.random.default_rng(2).uniform(0.0, 1.0, 40))

    def bias_of(share):
        blended = lambda d: (AREAS * (share * d + (1 - share) * d**2)).sum() / AREAS.sum()  # noqa: E731
        return project_to_volume(some_logits(), blended, 0.4)[1]

    assert torch.autograd.gradcheck(bias_of, firm.requires_grad_(), eps=1e-5, rtol=1e-6, atol=1e-9)


def test_taylor_remainder_falls_with_the_square_of_the_step():
    logits = some_logits().requires_grad_()
    pull, direction = some_logits(5), some_logits(6)

    def loss(at):
        return (pull * project_to_volume(at, fraction, 0.4)[0]).sum()

    start = loss(logits)
    (gradient,) = torch.autograd.grad(start, logits)
    steps = np.array([4e-3, 2e-3, 1e-3])
    remainder = [abs((loss(logits + h * direction) - start - h * gradient @ direction).item()) for h in steps]
    assert np.polyfit(np.log(steps), np.log(remainder), 1)[0] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("target", [0.05, 0.1, 0.65, 0.9, float("nan")])
def test_volume_out_of_reach_is_refused(target):
    with pytest.raises(SolverError, match="no design has the volume"):
        project_to_volume(some_logits(), fraction, target)


@pytest.mark.parametrize("sharpness", [1.0, 4.0, 50.0])
def test_a_steep_projection_meets_the_volume_too_with_exact_derivatives(sharpness):
    d, bias = project_to_volume(some_logits(), fraction, 0.4, sharpness)
    assert fraction(d).item() == pytest.approx(0.4, abs=1e-13)
    torch.testing.assert_close(project(some_logits(), bias, sharpness), d, rtol=0, atol=0)

    def level(logits):
        return project_to_volume(logits, fraction, 0.4, sharpness)[1]

    assert torch.autograd.gradcheck(level, some_logits(spread=0.3).requires_grad_(), eps=1e-6, rtol=1e-5)


def test_a_steep_projection_leaves_little_between():
    plain, steep = (project_to_volume(some_logits(), fraction, 0.4, slope)[0] for slope in (1.0, 30.0))
    assert float((steep * (1 - steep)).mean()) < 0.2 * float((plain * (1 - plain)).mean())
