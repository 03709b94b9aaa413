"""From a body model's own pose to the skeleton's neutral pose, joint centres on joint centres.

First each limb segment is stretched along itself to the skeleton's length (blended linearly, nothing turns),
then each is carried rigidly to its place (blended as dual quaternions), so that girths stay as they were.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.body.segments import BONES, JOINTS, SEGMENTS, SIDES
from hilbrace.body.skinning import skin

Array = np.ndarray
Joints = dict[str, Float[Array, " 3"]]

STRAIGHT = 0.03
"""Sine of the elbow's angle below which an arm counts as straight, so that it has no plane of its own."""


@dataclass(frozen=True)
class Placement:
    """What brings a body in its own pose onto a skeleton.

    Attributes:
        start: Fixed point of each bone's stretch in the own pose [m], in the order of `BONES`.
        stretch: Matrix of the stretch.
        shift: Where the fixed point goes [m].
        rotation: Rotation into the neutral pose.
        translation: Translation after it [m].
    """

    start: Float[Array, "bone 3"]
    stretch: Float[Array, "bone 3 3"]
    shift: Float[Array, "bone 3"]
    rotation: Float[Array, "bone 3 3"]
    translation: Float[Array, "bone 3"]

    def apply(
        self, vertices: Float[Array, "vertex 3"], weights: Float[Array, "vertex bone"]
    ) -> Float[Array, "vertex 3"]:
        """The skin in the neutral pose [m].

        Args:
            vertices: Skin in its own pose [m].
            weights: Weights in the order of `BONES`.
        """
        moved = np.einsum("bij,vbj->vbi", self.stretch, vertices[:, None] - self.start) + self.shift
        stretched = np.einsum("vb,vbi->vi", weights, moved)
        return skin(stretched, weights, self.rotation[None], self.translation[None])[0]


def place(own: Joints, target: Joints) -> Placement:
    """Find the placement of a body with given joint centres.

    The shoulders alone stay where the trunk carries them and the upper arms reach from there to the
    skeleton's elbows: the skeleton's shoulder lies higher than a person's with the arms down. A limb whose
    joints are not all given rides on the pelvis.

    Args:
        own: Joint centres of the body model in its own pose [m]; fingers, where given, tell the palms.
        target: Joint centres of the skeleton in its neutral pose [m].
    """
    count = len(BONES)
    start, shift = np.zeros((count, 3)), np.zeros((count, 3))
    stretch, rotation = np.tile(np.eye(3), (count, 1, 1)), np.tile(np.eye(3), (count, 1, 1))
    pelvis_shift = _pelvis_shift(own, target)
    translation = np.tile(pelvis_shift, (count, 1))
    target = target | {n: own[n] + pelvis_shift for n in ("shoulder_r", "shoulder_l") if n in own}
    for side in SIDES:
        chain = dict(own)
        turns = _leg_rotations(own, target, side) | _arm_rotations(own, target, side)
        for segment in SEGMENTS:
            begin, end = f"{segment.start}_{side}", f"{segment.end}_{side}"
            if segment.bones[0] not in turns:
                continue
            axis, length = _split(own[end] - own[begin])
            ratio = _split(target[end] - target[begin])[1] / length
            chain[end] = chain[begin] + ratio * (own[end] - own[begin])
            for bone in segment.bones:
                row = BONES.index(f"{bone}_{side}")
                stretch[row] += (ratio - 1.0) * np.outer(axis, axis)
                start[row], shift[row] = own[begin], chain[begin]
                rotation[row] = turns[bone]
                translation[row] = target[begin] - turns[bone] @ chain[begin]
        for bone, joint in (("calcn", "ankle"), ("toes", "ankle"), ("hand", "wrist")):
            if bone not in turns:
                continue
            row, name = BONES.index(f"{bone}_{side}"), f"{joint}_{side}"
            start[row], shift[row] = own[name], chain[name]
            rotation[row] = turns[bone]
            translation[row] = target[name] - turns[bone] @ chain[name]
    return Placement(start, stretch, shift, rotation, translation)


def joint_distances(own: Joints, target: Joints) -> Float[Array, " joint"]:
    """How far the body model's hips, knees and ankles are from the skeleton's in the neutral pose [m].

    The body model's legs are straightened with their own lengths, the middle of its hips on the
    skeleton's; in the order of `JOINTS`, 0 for a leg that is not given.
    """
    shift = _pelvis_shift(own, target)
    placed: Joints = {}
    for side in SIDES:
        hip, knee, ankle = (f"{joint}_{side}" for joint in ("hip", "knee", "ankle"))
        if hip not in own:
            continue
        placed[hip] = own[hip] + shift
        for begin, end in ((hip, knee), (knee, ankle)):
            direction = _split(target[end] - target[begin])[0]
            placed[end] = placed[begin] + _split(own[end] - own[begin])[1] * direction
    return np.array([np.linalg.norm(placed.get(name, target[name]) - target[name]) for name in JOINTS])


def _pelvis_shift(own: Joints, target: Joints) -> Float[Array, " 3"]:
    hips = [name for name in ("hip_r", "hip_l") if name in own]
    return np.mean([target[name] - own[name] for name in hips], axis=0)


def _leg_rotations(own: Joints, target: Joints, side: str) -> dict[str, Float[Array, "3 3"]]:
    """Rotation of the bones of one leg into the neutral pose.

    Thigh and shank turn the shortest way; the foot stays as it is, flat and forward.
    """
    names = [f"{joint}_{side}" for joint in ("hip", "knee", "ankle")]
    if any(name not in own for name in names):
        return {}
    hip, knee, ankle = (own[name] for name in names)
    hip_there, knee_there, ankle_there = (target[name] for name in names)
    return {
        "femur": shortest_turn(knee - hip, knee_there - hip_there),
        "tibia": shortest_turn(ankle - knee, ankle_there - knee_there),
        "calcn": np.eye(3),
        "toes": np.eye(3),
    }


def _arm_rotations(own: Joints, target: Joints, side: str) -> dict[str, Float[Array, "3 3"]]:
    """Rotation of the bones of one arm into the neutral pose.

    The plane of upper arm and forearm becomes the sagittal plane, and the forearm turns until the palm looks
    forward (the skeleton's zero); a hand without fingers stays as it lies on the forearm.
    """
    names = [f"{joint}_{side}" for joint in ("shoulder", "elbow", "wrist")]
    if any(name not in own for name in names):
        return {}
    (upper, lower), (upper_there, lower_there) = (
        (arm[names[1]] - arm[names[0]], arm[names[2]] - arm[names[1]]) for arm in (own, target)
    )
    flexion = np.array([0.0, 0.0, 1.0])
    lateral = flexion if side == "r" else -flexion
    bend = np.cross(upper, lower)
    if np.linalg.norm(bend) < STRAIGHT * np.linalg.norm(upper) * np.linalg.norm(lower):
        turns = {"humerus": shortest_turn(upper, upper_there), "ulna": shortest_turn(lower, lower_there)}
    else:
        turns = {
            "humerus": _turn(upper, bend, upper_there, flexion),
            "ulna": _turn(lower, bend, lower_there, flexion),
        }
    hand = turns["ulna"]
    if f"index_{side}" in own:
        hand = _turn(lower, own[f"index_{side}"] - own[f"little_{side}"], lower_there, lateral)
    return turns | {"radius": hand, "hand": hand}


def _split(vector: Float[Array, " 3"]) -> tuple[Float[Array, " 3"], float]:
    length = float(np.linalg.norm(vector))
    return vector / length, length


def shortest_turn(source: Float[Array, "*batch 3"], goal: Float[Array, " 3"]) -> Float[Array, "*batch 3 3"]:
    """Shortest rotation that takes each direction to another, not opposite, one.

    Args:
        source: Directions, of any length.
        goal: Where they go.
    """
    a = source / np.linalg.norm(source, axis=-1, keepdims=True)
    b = _split(goal)[0]
    # Columns of the matrix of a cross product are the products with the axes.
    cross = np.cross(np.cross(a, b)[..., None, :], np.eye(3)).swapaxes(-1, -2)
    return np.eye(3) + cross + cross @ cross / (1.0 + a @ b)[..., None, None]


def _turn(
    source: Float[Array, " 3"], source_side: Array, goal: Float[Array, " 3"], goal_side: Array
) -> Float[Array, "3 3"]:
    """Rotation that takes one direction to another, and a second one as near to its goal as that allows."""
    return _frame(goal, goal_side) @ _frame(source, source_side).T


def _frame(first: Float[Array, " 3"], second: Float[Array, " 3"]) -> Float[Array, "3 3"]:
    along = _split(first)[0]
    across = _split(second - (second @ along) * along)[0]
    return np.column_stack([along, across, np.cross(along, across)])
