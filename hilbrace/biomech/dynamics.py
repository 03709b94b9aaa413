"""Newton-Euler dynamics of rigid segments: net loads across joints, from motion and ground reactions.

Everything is in the ground frame unless said otherwise; all functions take every frame of a motion at once.
The net (intersegmental) load is what muscles, ligaments and contact transmit together across a joint (Winter
2009, Biomechanics and Motor Control of Human Movement, ch. 5).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline

from hilbrace.errors import InputError
from hilbrace.units import GRAVITY

Array = np.ndarray

WEIGHT = np.array([0.0, -GRAVITY, 0.0])
"""Gravitational acceleration, y up [m/s^2]."""
SPLINE_DEGREE = 5
FEWEST_FRAMES = 8


class Wrench(NamedTuple):
    """A force [N] and a moment [N*m] about a point that the context names."""

    force: Float[Array, "frame 3"]
    moment: Float[Array, "frame 3"]


class GroundReaction(NamedTuple):
    """What the ground does to one foot.

    Attributes:
        force: Force on the foot [N].
        point: Where it acts [m].
        torque: Torque on the foot about that point [N*m].
    """

    force: Float[Array, "frame 3"]
    point: Float[Array, "frame 3"]
    torque: Float[Array, "frame 3"]


class Momenta(NamedTuple):
    """Segments in motion.

    Attributes:
        masses: Masses [kg].
        centres: Centres of mass [m].
        force: Rate of momentum less weight, m (a - g) [N].
        torque: Rate of angular momentum about the centre of mass [N*m].
    """

    masses: Float[Array, " body"]
    centres: Float[Array, "frame body 3"]
    force: Float[Array, "frame body 3"]
    torque: Float[Array, "frame body 3"]


def time_derivative(values: Float[Array, "frame ..."], rate_hz: float) -> Float[Array, "frame ..."]:
    """First derivative along the frames, of the quintic spline through the values [unit/s].

    Raises:
        InputError: There are too few frames.
    """
    if len(values) < FEWEST_FRAMES:
        raise InputError(
            f"{len(values)} frames are too few for accelerations",
            where="motion",
            hint=f"use at least {FEWEST_FRAMES} frames: widen motion.window",
        )
    time = np.arange(len(values)) / rate_hz
    return make_interp_spline(time, values, k=SPLINE_DEGREE).derivative()(time)


def angular_velocity(
    rotations: Float[Array, "frame body 3 3"], rate_hz: float
) -> Float[Array, "frame body 3"]:
    """Angular velocity of turning frames, in the ground [rad/s].

    Args:
        rotations: Rotation matrices, body to ground.
        rate_hz: Frames per second [Hz].
    """
    spin = time_derivative(rotations, rate_hz) @ np.swapaxes(rotations, -1, -2)
    return 0.5 * np.stack(
        [
            spin[..., 2, 1] - spin[..., 1, 2],
            spin[..., 0, 2] - spin[..., 2, 0],
            spin[..., 1, 0] - spin[..., 0, 1],
        ],
        axis=-1,
    )


def inertia_in_ground(
    rotations: Float[Array, "frame body 3 3"], inertias: Float[Array, "body 3 3"]
) -> Float[Array, "frame body 3 3"]:
    """Inertia tensors turned with their bodies [kg*m^2]."""
    return rotations @ inertias @ np.swapaxes(rotations, -1, -2)


def momenta(
    rotations: Float[Array, "frame body 3 3"],
    origins: Float[Array, "frame body 3"],
    masses: Float[Array, " body"],
    centres: Float[Array, "body 3"],
    inertias: Float[Array, "body 3 3"],
    rate_hz: float,
) -> Momenta:
    """What it takes to move rigid bodies as they move.

    Args:
        rotations: Rotation matrices, body to ground.
        origins: Origins of the bodies' frames [m].
        masses: Masses [kg].
        centres: Centres of mass in the bodies' frames [m].
        inertias: Inertias about the centres of mass in the bodies' frames [kg*m^2].
        rate_hz: Frames per second [Hz].
    """
    places = origins + np.einsum("fbij,bj->fbi", rotations, centres)
    acceleration = time_derivative(time_derivative(places, rate_hz), rate_hz)
    spin = angular_velocity(rotations, rate_hz)
    momentum = np.einsum("fbij,fbj->fbi", inertia_in_ground(rotations, inertias), spin)
    return Momenta(
        masses,
        places,
        masses[:, None] * (acceleration - WEIGHT),
        time_derivative(momentum, rate_hz),
    )


def net_load(
    moving: Momenta, below: list[int], centre: Float[Array, "frame 3"], reactions: list[GroundReaction]
) -> Wrench:
    """Load of the proximal on the distal segment across a joint.

    Args:
        moving: All segments.
        below: Segments on the distal side of the joint.
        centre: The joint's centre [m].
        reactions: Ground reactions on those segments.

    Returns:
        Force, and moment about the joint's centre, ground frame.
    """
    arms = moving.centres[:, below] - centre[:, None]
    force = moving.force[:, below].sum(axis=1)
    moment = (np.cross(arms, moving.force[:, below]) + moving.torque[:, below]).sum(axis=1)
    for reaction in reactions:
        force = force - reaction.force
        moment = moment - np.cross(reaction.point - centre, reaction.force) - reaction.torque
    return Wrench(force, moment)


def generalised_inertia(
    turn: Float[Array, "frame body 3 axis"],
    shift: Float[Array, "frame body 3 axis"],
    masses: Float[Array, " body"],
    inertias: Float[Array, "frame body 3 3"],
) -> Float[Array, "frame axis axis"]:
    """Mass matrix of some coordinates: sum over bodies of m v_j.v_k + w_j.I w_k [kg*m^2].

    Args:
        turn: Angular velocity of each body per unit speed of each coordinate [1].
        shift: Velocity of its centre of mass likewise [m].
        masses: Masses [kg].
        inertias: Inertias about the centres of mass, in the ground frame [kg*m^2].
    """
    translation = np.einsum("b,fbij,fbik->fjk", masses, shift, shift)
    return translation + np.einsum("fbij,fbil,fblk->fjk", turn, inertias, turn)
