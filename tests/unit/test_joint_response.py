"""The joint's response against closed forms of a one-axis oscillator, and its gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hilbrace.optimize.joint_response import (
    DAMPING_RATIO,
    JointMotion,
    angle_change,
    joint_motion,
    stiffness_along,
)
from hilbrace.units import DEG
from tests.unit.knee_tube import knee_loads


def _motion(time: np.ndarray, angles: np.ndarray, inertia=(0.4, 0.4, 0.05), passive=(30.0, 280.0, 80.0)):
    tensor = lambda values: torch.as_tensor(np.asarray(values), dtype=torch.float64)  # noqa: E731
    masses = np.broadcast_to(np.diag(inertia), (len(time), 3, 3))
    return JointMotion(tensor(time), tensor(angles), tensor(masses.copy()), tensor(passive))


def _steady(stiffness: float, frames: int) -> torch.Tensor:
    return torch.diag(torch.tensor([stiffness] * 3, dtype=torch.float64)).expand(frames, 3, 3)


def test_a_held_posture_is_the_balance_of_two_springs():
    time = np.linspace(0, 2, 121)
    angles = np.tile([0.5, 0.1, -0.05], (len(time), 1))
    change = angle_change(_motion(time, angles), _steady(10.0, len(time)))
    expected = -10.0 * angles / (np.array([30.0, 280.0, 80.0]) + 10.0)
    np.testing.assert_allclose(change.numpy(), expected, rtol=1e-12)


def test_a_swinging_joint_follows_the_driven_oscillator():
    """The steady response to ``phi = a sin(w t)`` has amplitude ``k a / |K + k - M w^2 + i C w|``."""
    mass, passive, brace, amplitude, omega = 0.4, 280.0, 20.0, 0.1, 2 * np.pi * 2.5
    time = np.arange(0, 12, 1 / 480)
    angles = np.zeros((len(time), 3))
    angles[:, 1] = amplitude * np.sin(omega * time)
    motion = _motion(time, angles, inertia=(mass,) * 3, passive=(passive,) * 3)
    change = angle_change(motion, _steady(brace, len(time))).numpy()[:, 1]
    drag = 2 * DAMPING_RATIO * np.sqrt(passive * mass)
    impedance = passive + brace - mass * omega**2 + 1j * drag * omega
    expected = np.imag(-brace * amplitude / impedance * np.exp(1j * omega * time))
    late = time > 8.0
    assert np.abs(change[late] - expected[late]).max() < 5e-3 * brace * amplitude / abs(impedance)


def test_the_gradient_is_that_of_finite_differences():
    loads = knee_loads(40)
    motion = joint_motion(loads, "knee_l", (0.5, 5.0, 1.5))
    frames = len(motion.time)
    generator = torch.Generator().manual_seed(3)
    root = torch.rand((frames, 3, 3), generator=generator, dtype=torch.float64)
    brace = (3.0 * root @ root.transpose(1, 2)).requires_grad_()
    weights = torch.randn((frames, 3), generator=generator, dtype=torch.float64)
    loss = (angle_change(motion, brace) * weights).sum()
    (gradient,) = torch.autograd.grad(loss, brace)
    direction = torch.randn((frames, 3, 3), generator=generator, dtype=torch.float64)
    step = 1e-5
    with torch.no_grad():
        ahead = (angle_change(motion, brace + step * direction) * weights).sum()
        behind = (angle_change(motion, brace - step * direction) * weights).sum()
    slope = float((ahead - behind) / (2 * step))
    assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-7)


def test_an_unbraced_joint_keeps_its_motion():
    motion = joint_motion(knee_loads(), "knee_l", (0.5, 5.0, 1.5))
    change = angle_change(motion, torch.zeros((len(motion.time), 3, 3), dtype=torch.float64))
    assert float(change.abs().max()) == 0.0


def test_passive_stiffness_is_converted_once():
    motion = joint_motion(knee_loads(), "knee_l", (0.5, 5.0, 1.5))
    np.testing.assert_allclose(motion.passive.numpy() * DEG, [0.5, 5.0, 1.5])


def test_stiffness_is_linear_between_postures_and_flat_outside():
    flexions = torch.tensor([0.0, 1.0], dtype=torch.float64)
    posed = torch.stack([torch.eye(3, dtype=torch.float64), 3.0 * torch.eye(3, dtype=torch.float64)])
    along = stiffness_along(torch.tensor([-0.2, 0.0, 0.25, 1.0, 1.4], dtype=torch.float64), flexions, posed)
    np.testing.assert_allclose(along[:, 0, 0].numpy(), [1.0, 1.0, 1.5, 3.0, 3.0])
