"""What the ground must supply: the Newton-Euler equations of the whole body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.skeleton.kinematics import Pose, Skeleton
from hilbrace.units import GRAVITY

Array = np.ndarray


@dataclass(frozen=True)
class BodyWrench:
    """External force and moment that a motion needs, and the momentum that they change.

    Attributes:
        force: Force of the ground [N].
        moment: Its moment about the origin of the ground [N*m].
        com: Centre of mass [m].
        angular_momentum: About the centre of mass [kg*m^2/s].
    """

    force: Float[Array, "frame 3"]
    moment: Float[Array, "frame 3"]
    com: Float[Array, "frame 3"]
    angular_momentum: Float[Array, "frame 3"]


def body_wrench(
    skeleton: Skeleton,
    pose: Pose,
    com_acceleration: Float[Array, "frame 3"],
    derivative: Float[Array, "frame frame"],
) -> BodyWrench:
    """Force and moment of the ground from the motion of all bodies.

    Args:
        skeleton: Masses and inertias.
        pose: Frames of the bodies.
        com_acceleration: Acceleration of the whole body's centre of mass [m/s^2].
        derivative: Matrix that differentiates samples in time [1/s].

    Returns:
        Force m (a + g) and moment dL/dt + c x F, L being the angular momentum about the centre of mass c.
    """
    centres = skeleton.centres(pose)
    rotations = np.stack([pose[body].rotation for body in skeleton.bodies], axis=1)
    com = np.einsum("b,tbi->ti", skeleton.masses, centres) / skeleton.mass
    relative = centres - com[:, None]
    velocity = np.tensordot(derivative, relative, 1)
    spin = np.tensordot(derivative, rotations, 1) @ rotations.transpose(0, 1, 3, 2)
    omega = 0.5 * np.stack(
        [
            spin[..., 2, 1] - spin[..., 1, 2],
            spin[..., 0, 2] - spin[..., 2, 0],
            spin[..., 1, 0] - spin[..., 0, 1],
        ],
        axis=-1,
    )
    inertia = rotations @ skeleton.inertia @ rotations.transpose(0, 1, 3, 2)
    angular = np.einsum("b,tbi->ti", skeleton.masses, np.cross(relative, velocity))
    angular = angular + np.einsum("tbij,tbj->ti", inertia, omega)
    force = skeleton.mass * (com_acceleration + np.array([0.0, GRAVITY, 0.0]))
    moment = derivative @ angular + np.cross(com, force)
    return BodyWrench(force, moment, com, angular)
