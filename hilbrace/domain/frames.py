"""The frames of the motion that the design looks at, and the skin in each of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.body.body import Body
from hilbrace.body.posing import bone_transforms
from hilbrace.body.skinning import SKINNINGS, bind, one_leg
from hilbrace.errors import ConfigError, GeometryError, InputError
from hilbrace.units import MM_PER_M

Array = np.ndarray

_DISTAL = {"knee": "tibia", "ankle": "talus"}
_SKIN_BELOW = {"knee": "tibia", "ankle": "calcn"}
"""Bone of the skeleton below each joint, and bone that carries the skin there."""

MAX_FRAMES = 300
"""Most frames that a design looks at; more of them are thinned out evenly."""


def choose_frames(
    time: Float[Array, " frame"],
    flexion: Float[Array, " frame"],
    acting_force: Float[Array, "frame 3"],
    frames_per_second: float,
) -> Int[Array, " kept"]:
    """Frames at an even rate, plus those of peak flexion and of peak acting force.

    Args:
        time: Instants [s].
        flexion: Flexion of the braced joint [rad].
        acting_force: Force across the braced joint [N].
        frames_per_second: Wanted rate [1/s]; lowered where it would give more than `MAX_FRAMES`.

    Returns:
        Frame numbers, ascending.
    """
    span = float(time[-1] - time[0])
    steps = min(int(span * frames_per_second + 1e-9), MAX_FRAMES - 3)
    even = time[0] + np.arange(steps + 1) * (max(1.0 / frames_per_second, span / (MAX_FRAMES - 3)))
    nearest = np.abs(time[None, :] - even[:, None]).argmin(axis=1)
    strength = np.linalg.norm(acting_force, axis=1)
    return np.unique(np.concatenate([nearest, [np.argmax(flexion), np.argmax(strength)]]))


def frames_of(loads: JointLoads, joint: str, frames_per_second: float) -> Int[Array, " kept"]:
    """Frames of a recording to design for, see `choose_frames`.

    Raises:
        ConfigError: The recording holds no loads of the joint.
        InputError: Coordinates, angles or forces are missing (NaN).
    """
    if joint not in loads.joints:
        raise ConfigError(
            f"the loads hold no joint {joint!r}",
            where="domain.joint, domain.side",
            hint=f"joints there are: {', '.join(loads.joints)}",
        )
    at = loads.joints.index(joint)
    flexion, force = loads.angles[:, at, 0], loads.acting_force[:, at]
    unknown = ~(
        np.isfinite(loads.coordinates).all(axis=1) & np.isfinite(flexion) & np.isfinite(force).all(axis=1)
    )
    if unknown.any():
        raise InputError(
            f"angles or forces are missing in {int(unknown.sum())} frames",
            where=f"motion at {loads.time[np.argmax(unknown)]:.3f} s",
            hint="choose a part of the recording without gaps (motion.window)",
        )
    return choose_frames(loads.time, flexion, force, frames_per_second)


def pose_in_distal(
    rest: Float[Array, "vertex 3"],
    joint: str,
    body: Body,
    coordinate_names: tuple[str, ...],
    coordinates: Float[Array, "frame coordinate"],
) -> Float[Array, "frame vertex 3"]:
    """Move the domain with the body's skin, and take the distal bone's rigid motion out again.

    The distal bone is the one that `JointLoads` gives its forces and axes in: the tibia of a knee, the talus
    of an ankle.

    Args:
        rest: Domain vertices [mm], neutral pose, origin at the joint centre.
        joint: ``knee_l``, ``ankle_r``, ...
        body: The body whose skinning moves them.
        coordinate_names: Names of the coordinates.
        coordinates: Their values in the frames wanted [rad or m].

    Returns:
        Positions [mm] in the frame of the neutral distal bone, origin at the joint centre.

    Raises:
        GeometryError: The body's skin hangs on no bone below the joint.
    """
    centre = body.joint_centres[body.joint_names.index(joint)]
    rotations, translations = bone_transforms(body, coordinate_names, coordinates)
    points = rest / MM_PER_M + centre
    posed = SKINNINGS[body.skinning](points, bind(points, one_leg(body, joint[-1])), rotations, translations)
    _check_bone(body, f"{_SKIN_BELOW[joint[:-2]]}_{joint[-1]}")
    # The talus carries no skin of its own: it is asked for by name, as any body of the skeleton can be.
    distal = replace(body, bones=(f"{_DISTAL[joint[:-2]]}_{joint[-1]}",))
    rotation, translation = bone_transforms(distal, coordinate_names, coordinates)
    return (to_bone(posed, rotation[:, 0], translation[:, 0]) - centre) * MM_PER_M


def to_bone(
    points: Float[Array, "frame point 3"],
    rotation: Float[Array, "frame 3 3"],
    translation: Float[Array, "frame 3"],
) -> Float[Array, "frame point 3"]:
    """Where points that move with the skin are for an observer who rides on a bone.

    Args:
        points: Posed positions.
        rotation: Rotation of the bone from neutral to posed.
        translation: Translation of the bone, ``x_posed = rotation x_neutral + translation``.
    """
    return (points - translation[:, None, :]) @ rotation


def _check_bone(body: Body, name: str) -> None:
    if name not in body.bones:
        raise GeometryError(
            f"the body's skin hangs on no bone {name!r}",
            where="bones of the body",
            hint=f"bones there are: {', '.join(body.bones)}",
        )
