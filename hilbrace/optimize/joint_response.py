"""How a brace changes the joint's motion: a small perturbation about the measured angles.

The knee with its passive stiffness and the inertia of what hangs below it follows
``M dd + C d + K_joint delta + K_brace (phi + delta - phi_0) = 0`` about the recorded motion, where ``delta``
is the change of (flexion, adduction, rotation). Landing is over in 50 to 100 ms and the joint's own
frequency is a few hertz, so the response is integrated and not taken as quasi-static.

The size of ``delta`` is set by the assumed passive stiffness. It is a model's prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.errors import InputError
from hilbrace.units import DEG

FLEXION, ADDUCTION, ROTATION = 0, 1, 2
DAMPING_RATIO = 0.3
"""Damping ratio of the relaxed joint [-], assumed; Zhang & Wang 2001 report it constant over effort."""


@dataclass(frozen=True)
class JointMotion:
    """The recorded motion of one joint on an even clock, as the response needs it.

    Attributes:
        time: Instants [s].
        angles: Flexion, adduction, rotation [rad].
        inertia: Generalised inertia about the three axes [kg*m^2].
        passive: Passive stiffness of the joint, diagonal [N*m/rad].
    """

    time: Float[Tensor, " frame"]
    angles: Float[Tensor, "frame 3"]
    inertia: Float[Tensor, "frame 3 3"]
    passive: Float[Tensor, "3"]


def joint_motion(
    loads: JointLoads, joint: str, passive_nm_per_deg: tuple[float, float, float], rate_hz: float = 60.0
) -> JointMotion:
    """Take one joint out of the loads, on an even clock.

    Args:
        loads: Kinematics of the recording.
        joint: Name of the joint, e.g. ``knee_l``.
        passive_nm_per_deg: Passive stiffness in flexion, adduction, rotation [N*m/deg].
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
    angles = _resample(time, loads.time, loads.angles[:, index])
    inertia = _resample(time, loads.time, loads.inertia[:, index].reshape(-1, 9)).reshape(-1, 3, 3)
    stiffness = np.asarray(passive_nm_per_deg) / DEG
    as_tensor = lambda values: torch.as_tensor(values, dtype=torch.float64)  # noqa: E731
    return JointMotion(as_tensor(time), as_tensor(angles), as_tensor(inertia), as_tensor(stiffness))


def damping(motion: JointMotion) -> Float[Tensor, "frame 3 3"]:
    """Diagonal damping that gives each axis its damping ratio on its own [N*m*s/rad]."""
    inertia = torch.diagonal(motion.inertia, dim1=1, dim2=2).clamp_min(1e-6)
    return torch.diag_embed(2.0 * DAMPING_RATIO * torch.sqrt(motion.passive * inertia))


def angle_change(motion: JointMotion, brace: Float[Tensor, "frame 3 3"]) -> Float[Tensor, "frame 3"]:
    """Change of the joint's angles by a brace, integrated by Newmark's average acceleration (1959).

    The motion starts in static equilibrium with the brace on.

    Args:
        motion: The recorded motion.
        brace: Stiffness of the brace about the joint's axes in each frame [N*m/rad]; the neutral pose is
            its rest.

    Returns:
        Change of (flexion, adduction, rotation) [rad], differentiable with respect to ``brace``.
    """
    step = float(motion.time[1] - motion.time[0])
    mass, drag = motion.inertia, damping(motion)
    stiffness = torch.diag_embed(motion.passive.expand(len(motion.time), 3)) + brace
    torque = -torch.einsum("fij,fj->fi", brace, motion.angles)
    lead_mass, lead_drag = 4.0 / step**2, 2.0 / step
    inverse = torch.linalg.inv(stiffness + lead_mass * mass + lead_drag * drag)

    position = torch.linalg.solve(stiffness[0], torque[0])
    velocity = torch.zeros_like(position)
    acceleration = torch.zeros_like(position)
    path = [position]
    for frame in range(1, len(motion.time)):
        carried_mass = lead_mass * position + 2.0 * lead_drag * velocity + acceleration
        carried_drag = lead_drag * position + velocity
        load = torque[frame] + mass[frame] @ carried_mass + drag[frame] @ carried_drag
        following = inverse[frame] @ load
        new_velocity = lead_drag * (following - position) - velocity
        acceleration = lead_mass * (following - position) - 2.0 * lead_drag * velocity - acceleration
        position, velocity = following, new_velocity
        path.append(position)
    return torch.stack(path)


def stiffness_along(
    flexion: Float[Tensor, " frame"],
    posture_flexions: Float[Tensor, " posture"],
    posture_stiffness: Float[Tensor, "posture 3 3"],
) -> Float[Tensor, "frame 3 3"]:
    """Brace stiffness in each frame, linear in flexion between the postures it was computed in.

    Args:
        flexion: Knee flexion per frame [rad].
        posture_flexions: Flexion of the postures, rising [rad].
        posture_stiffness: Stiffness about the joint's axes in each posture.
    """
    if len(posture_flexions) == 1:
        return posture_stiffness.expand(len(flexion), 3, 3)
    upper = torch.searchsorted(posture_flexions, flexion.contiguous()).clamp(1, len(posture_flexions) - 1)
    low, high = posture_flexions[upper - 1], posture_flexions[upper]
    share = ((flexion - low) / (high - low)).clamp(0.0, 1.0)[:, None, None]
    return (1.0 - share) * posture_stiffness[upper - 1] + share * posture_stiffness[upper]


def _resample(new: np.ndarray, old: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(new, old, column) for column in values.T], axis=1)
