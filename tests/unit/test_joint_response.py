"""The joint's response against closed forms of a one-axis oscillator, its limits, and its gradient."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.biomech.coupling import DAMPING_RATIO, proportional_damping
from hilbrace.errors import ConfigError
from hilbrace.optimize.joint_response import (
    JointMotion,
    angle_change,
    angle_change_by_wrench,
    joint_motion,
    resampling,
    stiffness_along,
    wrench_torque,
)
from hilbrace.units import DEG
from tests.unit.knee_tube import knee_loads

PASSIVE = (0.5, 5.0, 1.5)


def _motion(time: np.ndarray, angles: np.ndarray, inertia=(0.4, 0.4, 0.05), passive=(30.0, 280.0, 80.0)):
    frames = len(time)
    mass = np.broadcast_to(np.diag(inertia), (frames, 3, 3)).copy()
    spring = np.broadcast_to(np.diag(passive), (frames, 3, 3)).copy()
    drag = proportional_damping(mass, spring)
    jacobian = np.concatenate([np.zeros((frames, 3, 3)), np.broadcast_to(np.eye(3), (frames, 3, 3))], axis=1)
    return JointMotion(
        *map(torch.from_numpy, (time, np.asarray(angles, float), mass, drag, spring, jacobian))
    )


def _steady(stiffness: float, frames: int) -> torch.Tensor:
    return torch.diag(torch.tensor([stiffness] * 3, dtype=torch.float64)).expand(frames, 3, 3)


def _definite(frames: int, size: float, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    root = torch.rand((frames, 3, 3), generator=generator, dtype=torch.float64)
    return size * root @ root.transpose(1, 2)


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


def test_a_brace_without_end_pins_the_joint_at_its_rest_angle():
    motion = joint_motion(knee_loads(), "knee_l", PASSIVE)
    frames = len(motion.time)
    far = [angle_change(motion, _steady(10.0**power, frames)) + motion.angles for power in (6, 7, 8)]
    left = [float(braced.abs().max()) for braced in far]
    assert left[0] < 1e-2
    np.testing.assert_allclose([left[0] / left[1], left[1] / left[2]], 10.0, rtol=0.2)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.1, 50.0))
def test_a_slow_motion_is_the_static_balance_at_every_instant(seed, size):
    """Any brace and any joint stiffness: with a hundredth of the inertia's rates the path is quasi-static."""
    still = joint_motion(knee_loads(20, seconds=1.0), "knee_l", PASSIVE)
    frames = len(still.time)
    brace = _definite(1, size, seed).expand(frames, 3, 3)
    joint = still.stiffness[:1] + _definite(1, 20.0, seed + 1)
    motion = replace(
        still, stiffness=joint.expand(frames, 3, 3), inertia=1e-8 * still.inertia, damping=0 * still.damping
    )
    moved = motion.angles.clone()
    moved[:] = motion.angles[frames // 3]
    change = angle_change(replace(motion, angles=moved), brace)
    expected = torch.linalg.solve(motion.stiffness + brace, -torch.einsum("tij,tj->ti", brace, moved))
    np.testing.assert_allclose(change.numpy(), expected.numpy(), rtol=1e-7, atol=1e-12)


def test_the_gradient_by_the_stiffness_is_that_of_finite_differences():
    motion = joint_motion(knee_loads(40), "knee_l", PASSIVE)
    frames = len(motion.time)
    brace = _definite(frames, 3.0, 3).requires_grad_()
    generator = torch.Generator().manual_seed(4)
    weights = torch.randn((frames, 3), generator=generator, dtype=torch.float64)
    loss = (angle_change(motion, brace) * weights).sum()
    (gradient,) = torch.autograd.grad(loss, brace)
    direction = torch.randn((frames, 3, 3), generator=generator, dtype=torch.float64)
    step = 1e-4
    with torch.no_grad():
        ahead = (angle_change(motion, brace + step * direction) * weights).sum()
        behind = (angle_change(motion, brace - step * direction) * weights).sum()
    slope = float((ahead - behind) / (2 * step))
    assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-6)


def test_the_gradient_by_the_wrench_is_that_of_finite_differences():
    motion = joint_motion(knee_loads(40), "knee_l", PASSIVE)
    generator = torch.Generator().manual_seed(5)
    shape = (len(motion.time), 6)
    wrench, direction = (torch.randn(shape, generator=generator, dtype=torch.float64) for _ in range(2))
    weights = torch.randn((shape[0], 3), generator=generator, dtype=torch.float64)
    at = wrench.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((angle_change_by_wrench(motion, at) * weights).sum(), at)
    ahead, behind = (
        float((angle_change_by_wrench(motion, wrench + sign * 1e-2 * direction) * weights).sum())
        for sign in (1, -1)
    )
    assert float((gradient * direction).sum()) == pytest.approx((ahead - behind) / 2e-2, rel=1e-6)


def test_a_wrench_works_as_much_on_the_bones_as_its_moments_on_the_angles():
    """Virtual work: ``tau . dphi = F . dx + M . dtheta`` with the motion of the part below."""
    motion = joint_motion(knee_loads(40), "knee_l", PASSIVE)
    frames = len(motion.time)
    generator = torch.Generator().manual_seed(6)
    jacobian = torch.randn((frames, 6, 3), generator=generator, dtype=torch.float64)
    wrench = torch.randn((frames, 6), generator=generator, dtype=torch.float64)
    turned = torch.randn((frames, 3), generator=generator, dtype=torch.float64)
    motion = replace(motion, jacobian=jacobian)
    moved = torch.einsum("tij,tj->ti", jacobian, turned)
    np.testing.assert_allclose(
        (wrench_torque(motion, wrench) * turned).sum(1).numpy(), (wrench * moved).sum(1).numpy(), rtol=1e-10
    )


def test_a_moment_of_one_newton_metre_turns_the_knee_by_its_passive_compliance():
    """The note's figures: with 2, 5 and 10 N*m/deg a moment of 1 N*m gives 1/2, 1/5 and 1/10 of a degree."""
    for level in (2.0, 5.0, 10.0):
        loads = knee_loads(120, seconds=4.0)
        motion = joint_motion(loads, "knee_l", (0.5, level, 1.5))
        wrench = torch.zeros((len(motion.time), 6), dtype=torch.float64)
        wrench[:, 3:] = torch.einsum(
            "tij,j->ti", motion.jacobian[:, 3:], torch.tensor([0.0, 1.0, 0.0]).double()
        )
        change = angle_change_by_wrench(motion, wrench)[:, 1].numpy() / DEG
        np.testing.assert_allclose(change, 1.0 / level, rtol=1e-6)


def test_an_unbraced_joint_keeps_its_motion():
    motion = joint_motion(knee_loads(), "knee_l", PASSIVE)
    change = angle_change(motion, torch.zeros((len(motion.time), 3, 3), dtype=torch.float64))
    assert float(change.abs().max()) == 0.0


def test_passive_stiffness_is_converted_once_and_muscles_add_to_it():
    loads = knee_loads()
    motion = joint_motion(loads, "knee_l", PASSIVE)
    diagonal = torch.diagonal(motion.stiffness, dim1=1, dim2=2).numpy() * DEG
    np.testing.assert_allclose(diagonal, np.tile(PASSIVE, (len(diagonal), 1)))
    frames = len(loads.time)
    arms = np.zeros((frames, 4, 3, 1))
    arms[:, :, :2, 0] = 0.04, 0.03
    pulling = replace(
        loads,
        muscle_names=("medial",),
        muscle_max_force=np.array([1000.0]),
        muscle_optimal_length=np.array([0.1]),
        muscle_slack_length=np.array([0.2]),
        muscle_activation=np.full((frames, 1), 0.4),
        muscle_force=np.full((frames, 1), 400.0),
        muscle_pull=np.zeros((frames, 4, 1, 3)),
        muscle_arms=arms,
    )
    fibre, tendon = 23.4 * 400.0 / 0.1, 1.375 / 0.049 * 400.0 / 0.2
    along = 1 / (1 / fibre + 1 / tendon)
    expected = {
        "coupled": along * np.outer([0.04, 0.03, 0.0], [0.04, 0.03, 0.0]),
        "direct": along * np.diag([0.04**2, 0.03**2, 0.0]),
        "none": np.zeros((3, 3)),
    }
    for kind, stiffness in expected.items():
        stiffer = joint_motion(pulling, "knee_l", PASSIVE, kind).stiffness - motion.stiffness
        np.testing.assert_allclose(stiffer[5].numpy(), stiffness, atol=1e-10)
    with pytest.raises(ConfigError, match="'all'"):
        joint_motion(pulling, "knee_l", PASSIVE, "all")


def test_stiffness_is_linear_between_postures_and_flat_outside():
    flexions = torch.tensor([0.0, 1.0], dtype=torch.float64)
    posed = torch.stack([torch.eye(3, dtype=torch.float64), 3.0 * torch.eye(3, dtype=torch.float64)])
    along = stiffness_along(torch.tensor([-0.2, 0.0, 0.25, 1.0, 1.4], dtype=torch.float64), flexions, posed)
    np.testing.assert_allclose(along[:, 0, 0].numpy(), [1.0, 1.0, 1.5, 3.0, 3.0])


def test_resampling_is_linear_and_holds_the_ends():
    weights = resampling(np.array([0.0, 1.0, 3.0]), np.array([-1.0, 0.0, 0.5, 2.0, 3.0, 9.0]))
    np.testing.assert_allclose(weights @ np.array([1.0, 2.0, 6.0]), [1.0, 1.0, 1.5, 4.0, 6.0, 6.0])
