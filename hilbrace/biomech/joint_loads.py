"""The record that leaves the biomechanics stage: angles and loads of each joint, per frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float

Array = np.ndarray

JOINTS = ("knee_r", "knee_l", "ankle_r", "ankle_l")
"""Order of the joint axis."""


@dataclass(frozen=True)
class JointLoads:
    """Kinematics, net loads, muscle and contact forces, per frame and joint.

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
        convention: ``"intersegmental"``, or ``"paper_literal"``: see `hilbrace.biomech.contact.acting_force`.
        inertia: Generalised inertia of the part below the joint about its three axes [kg*m^2].
        distal_jacobian: What the part that carries the lower edge of a brace (tibia, foot) does per unit
            speed of each angle: velocity of its point in the joint's centre [m], then turn [-], distal
            frame. Its transpose takes a force on that part [N] and the moment about the joint's centre [N*m]
            to moments about the three angles. The part above the joint does not move with them.
        marker_names: Markers tracked.
        marker_bodies: Body that carries each.
        marker_error: Distance of each marker from the model's [m]; NaN in gaps.
        cutoff_hz: Low-pass cut-off applied to coordinates and forces [Hz].
        notes: What was left out or bridged on the way, one sentence each.
        pelvis_residual_force: What the pelvis of the model would need to be held with [N]; ground frame.
        pelvis_residual_moment: Moment of the same about the origin of the pelvis [N*m].
        residuals: Figures of both against the limits of Hicks et al. 2015; see
            `hilbrace.biomech.residuals.residual_figures`.
        joint_moment: Generalised force of inverse dynamics on each coordinate [N*m or N].
        reserve: Part of it that ideal actuators supply beside the muscles; NaN where no muscles were
            solved for.
        muscle_names: Muscles solved for; none if the model has none at these joints (then contact forces
            are NaN, and a note says so).
        muscle_max_force: Greatest isometric force of each [N].
        muscle_optimal_length: Optimal length of its fibres [m].
        muscle_slack_length: Slack length of its tendon [m].
        muscle_activation: Activations [-], 0 to 1.
        muscle_force: Tension of each muscle [N].
        muscle_arms: Moment about each of a joint's three angles per unit tension [m]; zero for muscles that
            do not cross the joint.
        muscle_pull: Line of action: force on the part below the joint per unit tension [-], distal frame;
            zero for muscles that do not cross.
        geometric_stiffness: What the muscles' tensions add to the stiffness about a joint's three angles
            because moment arms change with the angles, ``-sum F dR/dq`` [N*m/rad].
        contact_force: Force of the proximal on the distal bone where they touch: on the tibia at the knee, on
            the talus at the ankle, distal frame [N].
        contact_moment: Moment of the same about the joint's centre [N*m].
        contact_medial: Compression of the medial compartment of a knee [N]; NaN for ankles.
        contact_lateral: The same of the lateral compartment [N].
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
    distal_jacobian: Float[Array, "frame joint 6 3"]
    marker_names: tuple[str, ...]
    marker_error: Float[Array, "frame marker"]
    cutoff_hz: float
    pelvis_residual_force: Float[Array, "frame 3"]
    joint_moment: Float[Array, "frame coordinate"]
    reserve: Float[Array, "frame coordinate"]
    muscle_names: tuple[str, ...]
    muscle_max_force: Float[Array, " muscle"]
    muscle_optimal_length: Float[Array, " muscle"]
    muscle_slack_length: Float[Array, " muscle"]
    muscle_activation: Float[Array, "frame muscle"]
    muscle_force: Float[Array, "frame muscle"]
    muscle_arms: Float[Array, "frame joint 3 muscle"]
    muscle_pull: Float[Array, "frame joint muscle 3"]
    geometric_stiffness: Float[Array, "frame joint 3 3"]
    contact_force: Float[Array, "frame joint 3"]
    contact_moment: Float[Array, "frame joint 3"]
    contact_medial: Float[Array, "frame joint"]
    contact_lateral: Float[Array, "frame joint"]
    notes: tuple[str, ...] = ()
    marker_bodies: tuple[str, ...] = ()
    pelvis_residual_moment: Float[Array, "judged 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    residuals: dict[str, float] = field(default_factory=dict)


def without_muscles(frames: int, joints: int, coordinates: int) -> dict[str, Any]:
    """Fields of `JointLoads` for a motion whose muscle forces are not known: no muscles, contact NaN.

    Args:
        frames: Number of frames.
        joints: Number of joints.
        coordinates: Number of coordinates.
    """
    nothing, unknown = np.zeros(0), np.full((frames, joints), np.nan)
    return {
        "joint_moment": np.full((frames, coordinates), np.nan),
        "reserve": np.full((frames, coordinates), np.nan),
        "muscle_names": (),
        "muscle_max_force": nothing,
        "muscle_optimal_length": nothing,
        "muscle_slack_length": nothing,
        "muscle_activation": np.zeros((frames, 0)),
        "muscle_force": np.zeros((frames, 0)),
        "muscle_arms": np.zeros((frames, joints, 3, 0)),
        "muscle_pull": np.zeros((frames, joints, 0, 3)),
        "geometric_stiffness": np.zeros((frames, joints, 3, 3)),
        "contact_force": np.full((frames, joints, 3), np.nan),
        "contact_moment": np.full((frames, joints, 3), np.nan),
        "contact_medial": unknown,
        "contact_lateral": unknown.copy(),
    }
