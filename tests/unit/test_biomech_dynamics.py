"""Newton-Euler against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbrace.biomech.dynamics import (
    GroundReaction,
    angular_velocity,
    generalised_inertia,
    momenta,
    net_load,
    time_derivative,
)
from hilbrace.errors import InputError
from hilbrace.units import GRAVITY

RATE = 200.0
TIME = np.arange(201) / RATE
INNER = slice(15, -15)
"""Frames away from the ends, where splines are at their best."""


def turned(axis: int, angle: np.ndarray) -> np.ndarray:
    """Rotation matrices about a coordinate axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result = np.zeros((len(angle), 3, 3))
    result[:, axis, axis] = 1.0
    result[:, i, i] = result[:, j, j] = np.cos(angle)
    result[:, j, i], result[:, i, j] = np.sin(angle), -np.sin(angle)
    return result


def single(rotation, origin, mass, centre, inertia):
    return momenta(
        rotation[:, None], origin[:, None], np.array([mass]), np.array([centre]), np.array([inertia]), RATE
    )


@given(st.lists(st.floats(-3, 3), min_size=6, max_size=6))
def test_derivatives_of_quintics_are_exact(coefficients):
    polynomial = np.polynomial.Polynomial(coefficients)
    values = polynomial(TIME)
    assert np.allclose(time_derivative(values, RATE), polynomial.deriv()(TIME), atol=1e-8)


def test_too_few_frames_are_refused():
    with pytest.raises(InputError, match="7 frames"):
        time_derivative(np.zeros(7), RATE)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_angular_velocity_of_a_turn(axis):
    angle = 0.7 * np.sin(9.0 * TIME)
    expected = np.zeros((len(TIME), 3))
    expected[:, axis] = 6.3 * np.cos(9.0 * TIME)
    assert np.allclose(angular_velocity(turned(axis, angle)[:, None], RATE)[:, 0], expected, atol=2e-5)


def test_a_thrown_spinning_top_needs_no_load():
    """Ballistic flight and torque-free precession of a symmetric body about its angular momentum."""
    across, along, tilt, momentum = 0.4, 0.1, 0.6, 1.3
    precession = momentum / across
    spin = momentum * np.cos(tilt) * (1.0 / along - 1.0 / across)
    rotation = turned(2, precession * TIME) @ turned(0, np.full(len(TIME), tilt)) @ turned(2, spin * TIME)
    flight = np.stack([2.0 * TIME, 1.0 + 4.0 * TIME - 0.5 * GRAVITY * TIME**2, -0.3 * TIME], axis=1)
    centre = np.array([0.02, -0.1, 0.05])
    origin = flight - rotation @ centre
    body = single(rotation, origin, 3.0, centre, np.diag([across, across, along]))
    load = net_load(body, [0], origin, [])
    assert np.abs(load.force[INNER]).max() < 1e-3
    assert np.abs(load.moment[INNER]).max() < 1e-3


def test_physical_pendulum():
    """A rod that swings about a fixed end: force on the pivot and moment about it."""
    mass, length, inertia = 3.2, 0.25, 0.04
    angle = 0.8 * np.sin(5.0 * TIME)
    rate, acceleration = 4.0 * np.cos(5.0 * TIME), -20.0 * np.sin(5.0 * TIME)
    rotation = turned(2, angle)
    pivot = np.zeros((len(TIME), 3))
    body = single(rotation, pivot, mass, [0.0, -length, 0.0], np.diag([inertia, 0.01, inertia]))
    load = net_load(body, [0], pivot, [])
    along = np.stack([np.sin(angle), -np.cos(angle), 0 * angle], axis=1)
    across = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    motion = length * (acceleration[:, None] * across - rate[:, None] ** 2 * along)
    expected = mass * (motion + np.array([0.0, GRAVITY, 0.0]))
    turning = (inertia + mass * length**2) * acceleration + mass * GRAVITY * length * np.sin(angle)
    assert np.allclose(load.force[INNER], expected[INNER], atol=2e-3)
    assert np.allclose(load.moment[INNER, 2], turning[INNER], atol=2e-3)
    assert np.allclose(load.moment[INNER, :2], 0.0, atol=1e-6)


def test_standing_leg_passes_the_ground_reaction_on():
    """Shank over foot at rest: the knee carries the ground reaction less the weight below it."""
    frames = 20
    still = np.broadcast_to(np.eye(3), (frames, 2, 3, 3))
    origins = np.broadcast_to([[0.0, 0.5, 0.1], [0.0, 0.1, 0.1]], (frames, 2, 3))
    masses = np.array([3.0, 1.0])
    centres = np.array([[0.0, -0.2, 0.0], [0.05, -0.05, 0.0]])
    body = momenta(still, origins, masses, centres, np.zeros((2, 3, 3)), RATE)
    force = np.broadcast_to([10.0, 350.0, -5.0], (frames, 3))
    point = np.broadcast_to([0.08, 0.0, 0.12], (frames, 3))
    torque = np.broadcast_to([0.0, 2.0, 0.0], (frames, 3))
    knee = origins[:, 0]
    load = net_load(body, [0, 1], knee, [GroundReaction(force, point, torque)])
    weight = np.array([0.0, -4.0 * GRAVITY, 0.0])
    assert np.allclose(load.force, -weight - force)
    arm = (3.0 * np.array([0.0, -0.2, 0.0]) + np.array([0.05, -0.45, 0.0])) / 4.0
    expected = -np.cross(arm, weight) - np.cross(point - knee, force) - torque
    assert np.allclose(load.moment, expected)


def test_inertia_of_a_rod_about_its_end():
    mass, length = 2.0, 0.6
    turn = np.zeros((1, 1, 3, 1))
    turn[..., 2, 0] = 1.0
    shift = np.zeros((1, 1, 3, 1))
    shift[..., 0, 0] = length / 2
    slender = np.diag([mass * length**2 / 12, 0.0, mass * length**2 / 12])
    inertia = generalised_inertia(turn, shift, np.array([mass]), slender[None, None])
    assert inertia[0, 0, 0] == pytest.approx(mass * length**2 / 3)
