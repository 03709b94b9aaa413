"""The integrator against closed forms of an oscillator, and its adjoint against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbrace.optimize.trajectory import trajectory

DOUBLE = torch.float64


def definite(frames: int, size: float, generator: torch.Generator) -> torch.Tensor:
    """Random symmetric positive definite matrices of a size."""
    root = torch.randn((frames, 3, 3), generator=generator, dtype=DOUBLE)
    return size * (root @ root.transpose(1, 2) + 0.3 * torch.eye(3, dtype=DOUBLE))


def system(frames: int, seed: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inertia, damping, stiffness and torque of the size of a knee's."""
    generator = torch.Generator().manual_seed(seed)
    torque = torch.randn((frames, 3), generator=generator, dtype=DOUBLE)
    return (
        definite(frames, 0.1, generator),
        definite(frames, 1.0, generator),
        definite(frames, 100.0, generator),
        torque,
    )


def steady(matrix: torch.Tensor, frames: int) -> torch.Tensor:
    return matrix.expand(frames, 3, 3)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 12))
def test_the_gradient_of_every_input_is_that_of_finite_differences(seed, frames):
    inputs = [tensor.requires_grad_() for tensor in system(frames, seed)]
    weights = torch.randn((frames, 3), generator=torch.Generator().manual_seed(seed + 1), dtype=DOUBLE)

    def loss(*at: torch.Tensor) -> torch.Tensor:
        return (trajectory(*at, 1 / 60) * weights).sum()

    gradients = torch.autograd.grad(loss(*inputs), inputs)
    generator = torch.Generator().manual_seed(seed + 2)
    for index, (value, gradient) in enumerate(zip(inputs, gradients, strict=True)):
        direction = torch.randn(value.shape, generator=generator, dtype=DOUBLE) * value.detach().abs().mean()
        ahead, behind = list(inputs), list(inputs)
        size = 1e-4
        with torch.no_grad():
            ahead[index], behind[index] = value + size * direction, value - size * direction
            twice = (loss(*ahead) - loss(*behind)) / (2 * size)
            ahead[index], behind[index] = value + 2 * size * direction, value - 2 * size * direction
            wide = (loss(*ahead) - loss(*behind)) / (4 * size)
        slope = float((4 * twice - wide) / 3)
        scale = float((gradient * direction).abs().sum())
        assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-6, abs=1e-8 * scale)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_a_steady_torque_is_the_static_limit(seed):
    mass, drag, spring, torque = system(1, seed)
    frames = 30
    found = trajectory(
        steady(mass, frames),
        steady(drag, frames),
        steady(spring, frames),
        torque.expand(frames, 3),
        1 / 60,
    )
    expected = torch.linalg.solve(spring[0], torque[0])
    np.testing.assert_allclose(found.numpy(), expected.expand(frames, 3).numpy(), rtol=1e-8, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_no_torque_moves_nothing_and_the_path_is_linear_in_the_torque(seed):
    mass, drag, spring, torque = system(20, seed)
    assert float(trajectory(mass, drag, spring, torch.zeros_like(torque), 1 / 60).abs().max()) == 0.0
    once, thrice = (trajectory(mass, drag, spring, factor * torque, 1 / 60) for factor in (1.0, 3.0))
    np.testing.assert_allclose(thrice.numpy(), 3.0 * once.numpy(), rtol=1e-9, atol=1e-15)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_energy_is_kept_without_damping_and_lost_with_it(seed):
    """After the torque stops, kinetic plus elastic energy of the average-acceleration rule is constant."""
    mass, drag, spring, torque = system(1, seed)
    frames, step = 60, 1 / 240
    load = torch.zeros((frames, 3), dtype=DOUBLE)
    load[0] = torque[0]
    for damping, kept in ((torch.zeros_like(drag), True), (drag, False)):
        path = trajectory(steady(mass, frames), steady(damping, frames), steady(spring, frames), load, step)
        velocity = [torch.zeros(3, dtype=DOUBLE)]
        for now in range(1, frames):
            velocity.append(2 / step * (path[now] - path[now - 1]) - velocity[-1])
        speed = torch.stack(velocity)
        energy = 0.5 * torch.einsum("ti,ij,tj->t", speed, mass[0], speed)
        energy = (energy + 0.5 * torch.einsum("ti,ij,tj->t", path, spring[0], path)).numpy()[1:]
        if kept:
            np.testing.assert_allclose(energy, energy[0], rtol=1e-6)
        else:
            assert (np.diff(energy) < 1e-12).all()


def test_a_driven_oscillator_has_the_amplitude_of_its_impedance():
    mass, spring, drag, omega = 0.4, 280.0, 6.0, 2 * np.pi * 2.5
    time = np.arange(0, 12, 1 / 480)
    one = torch.eye(3, dtype=DOUBLE)
    torque = torch.from_numpy(np.tile(np.sin(omega * time)[:, None], (1, 3)))
    frames = len(time)
    path = trajectory(
        steady(mass * one, frames), steady(drag * one, frames), steady(spring * one, frames), torque, 1 / 480
    ).numpy()
    impedance = spring - mass * omega**2 + 1j * drag * omega
    expected = np.imag(np.exp(1j * omega * time) / impedance)
    late = time > 8.0
    assert np.abs(path[late] - expected[late, None]).max() < 5e-3 / abs(impedance)
