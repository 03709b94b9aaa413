"""The record that leaves the biomechanics stage: angles and loads of each joint, per frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray

JOINTS = ("knee_r", "knee_l", "ankle_r", "ankle_l")
"""Order of the joint axis."""


@dataclass(frozen=True)
class JointLoads:
    """Kinematics and net loads, per frame and joint.

    The distal frame of a joint is the OpenSim frame of its distal body (tibia, talus): x anterior, y up the
    segment, z to the subject's right. In the neutral pose it is parallel to the ground frame.

    Attributes:
        time: Instants [s].
        body_mass_kg: Mass [kg] that turns newtons into body weights.
        coordinate_names: The 41 free coordinates of the model.
        coordinates: Their values [rad or m].
        muscles: Number of muscles in the model.
        joints: Names, see `JOINTS`.
        angles: Flexion, adduction, internal rotation [rad] (ankle: dorsiflexion, inversion, 0;
            its third axis is normal to the other two, and the model does not turn about it).
        distal_rotation: Rotation of the distal body, its frame to ground.
        joint_axes: Unit axes of the three angles, in the distal frame; the distal body turns about
            ``joint_axes[..., k, :]`` when angle ``k`` grows.
        acting_force: Net force of the proximal on the distal segment across the joint (Eq. 1,
            ``convention``), in the distal frame [N].
        acting_moment: Net moment of the proximal on the distal segment about the joint's centre, in the
            distal frame [N*m].
        convention: ``"intersegmental"``.
        inertia: Generalised inertia of the part below the joint about its three axes [kg*m^2].
        marker_names: Markers tracked.
        marker_error: Distance of each marker from the model's [m]; NaN in gaps.
        cutoff_hz: Low-pass cut-off applied to coordinates and forces [Hz].
        notes: What was left out or bridged on the way, one sentence each.
        pelvis_residual_force: What the pelvis of the model would need to be held with [N]; ground frame.
    """

    time: Float[Array, " frame"]
    body_mass_kg: float
    coordinate_names: tuple[str, ...]
    coordinates: Float[Array, "frame coordinate"]
    muscles: int
    joints: tuple[str, ...]
    angles: Float[Array, "frame joint 3"]
    distal_rotation: Float[Array, "frame joint 3 3"]
    joint_axes: Float[Array, "frame joint 3 3"]
    acting_force: Float[Array, "frame joint 3"]
    acting_moment: Float[Array, "frame joint 3"]
    convention: str
    inertia: Float[Array, "frame joint 3 3"]
    marker_names: tuple[str, ...]
    marker_error: Float[Array, "frame marker"]
    cutoff_hz: float
    pelvis_residual_force: Float[Array, "frame 3"]
    notes: tuple[str, ...] = ()
