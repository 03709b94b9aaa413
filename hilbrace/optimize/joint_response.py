"""How a brace changes the joint's motion: a small perturbation about the measured angles.

With its passive tissue, its muscles at the tension they have, and the inertia of what hangs below, the joint
follows ``M dd + C d + K delta = tau`` about the recorded motion, where ``delta`` is the change of its three
angles and ``tau`` the moment of the brace about them. Landing is over in 50 to 100 ms and the joint's own
frequency is a few hertz, so the response is integrated and not taken as quasi-static. The segments above,
and the forces of the ground, are held as recorded.

The moment comes in two forms: a stiffness, ``tau = -K_brace (phi + delta - phi_0)``, or the wrench of the
brace on the part below the joint, ``tau = J^T W``. By the second, the thigh's share does not turn the knee:
the Jacobian of a part above the joint is zero while the pelvis moves as recorded.

The size of ``delta`` is set by the assumed passive stiffness. It is a model's prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.biomech.coupling import muscle_stiffness, proportional_damping
from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.errors import InputError
from hilbrace.optimize.trajectory import trajectory
from hilbrace.units import DEG

FLEXION = 0
"""Column of the sagittal angle, by which stiffness is interpolated between postures."""

RATE_HZ = 60.0
"""Rate of the clock on which the response is integrated [Hz]."""


@dataclass(frozen=True)
class JointMotion:
    """The recorded motion of one joint on an even clock, and what it takes to change it.

    Attributes:
        time: Instants [s].
        angles: The joint's three angles [rad].
        inertia: M about them [kg*m^2].
        damping: C [N*m*s/rad].
        stiffness: K of the joint without a brace [N*m/rad].
        jacobian: Velocity [m] of the part below the joint, in the joint's centre, and its turn [-], per unit
            speed of each angle, in the frame of the brace.
    """

    time: Float[Tensor, " instant"]
    angles: Float[Tensor, "instant 3"]
    inertia: Float[Tensor, "instant 3 3"]
    damping: Float[Tensor, "instant 3 3"]
    stiffness: Float[Tensor, "instant 3 3"]
    jacobian: Float[Tensor, "instant 6 3"]

    @property
    def step(self) -> float:
        """Time between instants [s]."""
        return float(self.time[1] - self.time[0])


def joint_motion(
    loads: JointLoads,
    joint: str,
    passive_nm_per_deg: tuple[float, float, float],
    muscles: str = "direct",
    rate_hz: float = RATE_HZ,
) -> JointMotion:
    """Take one joint out of the loads, on an even clock.

    Args:
        loads: Kinematics of the recording.
        joint: Name of the joint, e.g. ``knee_l``.
        passive_nm_per_deg: Passive stiffness about the three angles [N*m/deg].
        muscles: What the muscles add, see `hilbrace.biomech.coupling.muscle_stiffness`.
        rate_hz: Rate of the clock [Hz].

    Raises:
        InputError: The recording has fewer than three frames.
    """
    if len(loads.time) < 3:
        raise InputError(
            f"{len(loads.time)} frames are too few for a motion", where="biomech", hint="widen motion.window"
        )
    index = loads.joints.index(joint)
    count = max(3, round((loads.time[-1] - loads.time[0]) * rate_hz) + 1)
    time = np.linspace(loads.time[0], loads.time[-1], count)
    moved = resampling(loads.time, time)
    passive = np.diag(np.asarray(passive_nm_per_deg) / DEG)
    angles, inertia, added, jacobian = (
        np.tensordot(moved, values, axes=1)
        for values in (
            loads.angles[:, index],
            loads.inertia[:, index],
            muscle_stiffness(loads, joint, muscles),
            loads.distal_jacobian[:, index],
        )
    )
    damping = proportional_damping(inertia, passive + added)
    arrays = (time, angles, inertia, damping, passive + added, jacobian)
    return JointMotion(*map(torch.from_numpy, arrays))


def angle_change(motion: JointMotion, brace: Float[Tensor, "instant 3 3"]) -> Float[Tensor, "instant 3"]:
    """Change of the joint's angles by the stiffness of a brace.

    ``(K + K_brace) delta = -K_brace (phi - phi_0)`` where the motion is slow.

    Args:
        motion: The recorded motion.
        brace: Stiffness of the brace about the joint's angles at each instant [N*m/rad]; the neutral pose is
            its rest.

    Returns:
        Change of the three angles [rad], differentiable with respect to ``brace``.
    """
    torque = -torch.einsum("tij,tj->ti", brace, motion.angles)
    return trajectory(motion.inertia, motion.damping, motion.stiffness + brace, torque, motion.step)


def wrench_torque(motion: JointMotion, wrench: Float[Tensor, "instant 6"]) -> Float[Tensor, "instant 3"]:
    """Moments about the joint's angles of a wrench on the part below it, ``J^T W`` [N*m].

    Args:
        motion: The recorded motion.
        wrench: Force [N] and moment about the joint's centre [N*m] at each instant, in the brace's frame.
    """
    return torch.einsum("tij,ti->tj", motion.jacobian, wrench)


def angle_change_by_wrench(
    motion: JointMotion, wrench: Float[Tensor, "instant 6"]
) -> Float[Tensor, "instant 3"]:
    """Change of the joint's angles by the wrench of a brace on the part below it [rad].

    Args:
        motion: The recorded motion.
        wrench: Force [N] and moment about the joint's centre [N*m], in the brace's frame.
    """
    torque = wrench_torque(motion, wrench)
    return trajectory(motion.inertia, motion.damping, motion.stiffness, torque, motion.step)


def stiffness_along(
    flexion: Float[Tensor, " frame"],
    posture_flexions: Float[Tensor, " posture"],
    posture_stiffness: Float[Tensor, "posture row column"],
) -> Float[Tensor, "frame row column"]:
    """Brace stiffness in each frame, linear in flexion between the postures it was computed in.

    Args:
        flexion: Flexion per frame [rad].
        posture_flexions: Flexion of the postures, rising [rad].
        posture_stiffness: Stiffness about the joint's axes in each posture.
    """
    if len(posture_flexions) == 1:
        return posture_stiffness.expand(len(flexion), *posture_stiffness.shape[1:])
    upper = torch.searchsorted(posture_flexions, flexion.contiguous()).clamp(1, len(posture_flexions) - 1)
    low, high = posture_flexions[upper - 1], posture_flexions[upper]
    share = ((flexion - low) / (high - low)).clamp(0.0, 1.0)[:, None, None]
    return (1.0 - share) * posture_stiffness[upper - 1] + share * posture_stiffness[upper]


def resampling(
    time: Float[np.ndarray, " sample"], instants: Float[np.ndarray, " instant"]
) -> Float[np.ndarray, "instant sample"]:
    """Weights that give values at other instants, linear between samples and constant beyond them.

    Args:
        time: Instants of the samples [s], rising.
        instants: Instants wanted [s].
    """
    return np.stack([np.interp(instants, time, sample) for sample in np.eye(len(time))], axis=1)
