"""The part of a body model that a scan of one leg, or of both, can show: shape, pose, and their slopes.

The legs hang in a chain pelvis - thigh - shank - foot. The skin follows by linear blending, which near the
straight leg of a standing person differs little from what the motion uses; what remains is left to the free
displacement (`hilbrace.scan.free_form`). Angles have the names, signs and zero of OpenSim's coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from hilbrace.body.model import BodyModel
from hilbrace.body.neutral import shortest_turn
from hilbrace.body.segments import BONES, SIDES, skeleton_joints
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.table import load_table

Array = np.ndarray

ANGLES = (
    "hip_flexion",
    "hip_adduction",
    "hip_rotation",
    "knee_angle",
    "knee_adduction",
    "knee_rotation",
    "ankle_angle",
    "subtalar_angle",
)
"""Angles of one leg, from the hip down; the side follows, ``knee_angle_l``."""

_TURNS = (
    ("hip", "z", 1.0, False),
    ("hip", "x", 1.0, True),
    ("hip", "y", 1.0, True),
    ("knee", "z", -1.0, False),
    ("knee", "x", 1.0, True),
    ("knee", "y", 1.0, True),
    ("ankle", "z", 1.0, False),
    ("ankle", "x", 1.0, True),
)
"""Joint, axis and sign of each of `ANGLES`, and whether the left leg mirrors it."""
_AXES = {"x": np.eye(3)[0], "y": np.eye(3)[1], "z": np.eye(3)[2]}
_SEGMENTS = (("femur",), ("tibia",), ("calcn", "toes"))
_LEAST_SHARE = 0.5
_STEP = 1e-5

Joints = dict[str, Float[Array, "3"]]


@dataclass(frozen=True)
class Limb:
    """The skin of one leg or both out of a body model.

    Attributes:
        model: The body model.
        sides: Legs, ``"l"`` and ``"r"``.
        vertex: Vertices of the model that belong to the limb.
        triangles: Their triangles, numbered within the limb.
        weights: Weights on the pelvis, then on thigh, shank and foot of each side.
        template: Skin of the mean person in the model's own pose [m].
        directions: Change per unit of each shape coefficient [m].
    """

    model: BodyModel
    sides: tuple[str, ...]
    vertex: Int[Array, " vertex"]
    triangles: Int[Array, "triangle 3"]
    weights: Float[Array, "vertex bone"]
    template: Float[Array, "vertex 3"]
    directions: Float[Array, "coefficient vertex 3"]

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Names of all joint angles, in the order of `Pose.angles`."""
        return tuple(f"{angle}_{side}" for side in self.sides for angle in ANGLES)


@dataclass(frozen=True)
class Pose:
    """Where a limb is and how it is bent.

    Attributes:
        rotation: Rotation of the pelvis from OpenSim axes into the scan's.
        translation: Place of the middle of the hips in the scan [m].
        angles: Joint angles, in the order of `Limb.angle_names` [rad].
    """

    rotation: Float[Array, "3 3"]
    translation: Float[Array, "3"]
    angles: Float[Array, " angle"]


@dataclass(frozen=True)
class PosedLimb:
    """A limb's skin in a pose.

    Attributes:
        vertices: Skin in the scan's frame [m].
        joints: Joint centres there [m], ``knee_l`` and so on.
        shape_slope: Change of the skin per unit of each shape coefficient.
        turn_slope: Change per radian about the scan's axes, through the middle of the hips.
        angle_slope: Change per radian of each joint angle.
        blend: The linear map of each vertex from the model's own pose.
    """

    vertices: Float[Array, "vertex 3"]
    joints: dict[str, Float[Array, "3"]]
    shape_slope: Float[Array, "coefficient vertex 3"]
    turn_slope: Float[Array, "3 vertex 3"]
    angle_slope: Float[Array, "angle vertex 3"]
    blend: Float[Array, "vertex 3 3"]


def limb_of(model: BodyModel, sides: tuple[str, ...]) -> Limb:
    """Cut the legs named out of a body model; with both, the skin between them belongs to it.

    Args:
        model: The body model.
        sides: ``("l",)``, ``("r",)`` or ``("r", "l")``.
    """
    whole = model.bone_weights()
    columns = [[BONES.index("pelvis")]]
    columns += [[BONES.index(f"{bone}_{side}") for bone in part] for side in sides for part in _SEGMENTS]
    shares = np.stack([whole[:, column].sum(axis=1) for column in columns], axis=1)
    counted = shares if len(sides) > 1 else shares[:, 1:]
    inside = counted.sum(axis=1) > _LEAST_SHARE
    triangles = model.triangles[inside[model.triangles].all(axis=1)]
    vertex, flat = np.unique(triangles, return_inverse=True)
    weights = shares[vertex]
    return Limb(
        model=model,
        sides=sides,
        vertex=vertex,
        triangles=np.ascontiguousarray(flat.reshape(-1, 3)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        template=model.template[vertex],
        directions=model.directions[:, vertex],
    )


def whole_body(model: BodyModel, sides: tuple[str, ...]) -> Limb:
    """All the skin of a body model, what is not on the legs named riding on the pelvis.

    Args:
        model: The body model.
        sides: Legs that move.
    """
    whole = model.bone_weights()
    columns = [[BONES.index(f"{bone}_{side}") for bone in part] for side in sides for part in _SEGMENTS]
    legs = np.stack([whole[:, column].sum(axis=1) for column in columns], axis=1)
    return Limb(
        model=model,
        sides=sides,
        vertex=np.arange(len(whole)),
        triangles=np.ascontiguousarray(model.triangles),
        weights=np.column_stack([1.0 - legs.sum(axis=1), legs]),
        template=model.template,
        directions=model.directions,
    )


def pose_limb(limb: Limb, shape: Float[Array, " coefficient"], pose: Pose) -> PosedLimb:
    """Bend a person's limb and put it into the scan, with the slopes that a fit needs.

    Args:
        limb: The limb.
        shape: All shape coefficients of the model.
        pose: Place and angles.
    """
    own = limb.model.joints(shape)
    moves = limb.model.joint_moves()
    rest = limb.template + np.tensordot(shape, limb.directions, 1)
    neutral, spins = _neutral_turns(own, _straight()), _neutral_spins(own, moves, _straight())
    hips = np.mean([own["hip_r"], own["hip_l"]], axis=0)
    hip_moves = (moves["hip_r"] + moves["hip_l"]) / 2.0
    still = np.zeros_like(hip_moves)
    turns, spinning = [pose.rotation], [still]
    start, start_moves = [hips], [hip_moves]
    end, end_moves = [pose.translation], [still]
    joints: dict[str, Float[Array, "3"]] = {}
    hinges: list[tuple[Float[Array, "3"], Float[Array, "3"], int, int]] = []
    for side in limb.sides:
        frame, parent = pose.rotation, 0
        first = limb.angle_names.index(f"{ANGLES[0]}_{side}")
        for part, (joint, bone) in enumerate(zip(("hip", "knee", "ankle"), _SEGMENTS, strict=True)):
            name = f"{joint}_{side}"
            centre = end[parent] + turns[parent] @ (own[name] - start[parent])
            centre_moves = end_moves[parent] + (moves[name] - start_moves[parent]) @ turns[parent].T
            drift: Array = np.cross(spinning[parent], centre - end[parent])
            centre_moves = centre_moves + drift
            below = len(turns)
            for number, (hinge, axis, sign, mirrored) in enumerate(_TURNS):
                if hinge != joint:
                    continue
                sign = -sign if mirrored and side == "l" else sign
                hinges.append((sign * frame @ _AXES[axis], centre, below, below + 2 - part))
                angle = sign * pose.angles[first + number]
                frame = frame @ Rotation.from_rotvec(angle * _AXES[axis]).as_matrix()
            joints[name] = centre
            turns.append(frame @ neutral.get(f"{bone[0]}_{side}", np.eye(3)))
            spinning.append(spins.get(f"{bone[0]}_{side}", still) @ frame.T)
            start.append(own[name])
            start_moves.append(moves[name])
            end.append(centre)
            end_moves.append(centre_moves)
            parent = below
    chain = (turns, spinning, start, start_moves, end, end_moves)
    return _posed(limb, rest, chain, joints, hinges, pose.translation)


def unposed(
    blend: Float[Array, "vertex 3 3"], displacement: Float[Array, "vertex 3"]
) -> Float[Array, "vertex 3"]:
    """Displacements of a posed skin as they are in the model's own pose [m].

    Args:
        blend: The linear map of each vertex from there.
        displacement: Displacements of the posed skin [m].
    """
    return np.linalg.solve(blend, displacement[:, :, None])[:, :, 0]


def _posed(
    limb: Limb,
    rest: Float[Array, "vertex 3"],
    chain: tuple[list[Array], ...],
    joints: dict[str, Float[Array, "3"]],
    hinges: list[tuple[Float[Array, "3"], Float[Array, "3"], int, int]],
    middle: Float[Array, "3"],
) -> PosedLimb:
    turns, spinning, start, start_moves, end, end_moves = map(np.stack, chain)
    weights = limb.weights
    at = np.einsum("bij,vbj->vbi", turns, rest[:, None] - start) + end
    vertices = np.einsum("vb,vbi->vi", weights, at)
    blend = np.einsum("vb,bij->vij", weights, turns)
    anchor_moves = end_moves - np.einsum("bij,bcj->bci", turns, start_moves)
    shape_slope = np.einsum("vij,cvj->cvi", blend, limb.directions)
    shape_slope += np.einsum("vb,bci->cvi", weights, anchor_moves)
    arms = weights.T[:, :, None] * (at - end).transpose(1, 0, 2)
    shape_slope += np.cross(spinning[:, :, None], arms[:, None]).sum(axis=0)
    angle_slope = np.stack(
        [
            np.einsum(
                "vb,vbi->vi", weights[:, low : high + 1], np.cross(axis, at[:, low : high + 1] - centre)
            )
            for axis, centre, low, high in hinges
        ]
    )
    turn_slope = np.stack([np.cross(axis, vertices - middle) for axis in np.eye(3)])
    return PosedLimb(vertices, joints, shape_slope, turn_slope, angle_slope, blend)


def _neutral_turns(own: Joints, straight: Joints) -> dict[str, Float[Array, "3 3"]]:
    """Turns of the segments from the model's own pose into the skeleton's neutral pose.

    As `hilbrace.body.neutral.place` has them: thigh and shank the shortest way, the others not at all.
    """
    return {
        name: shortest_turn(own[end] - own[start], straight[end] - straight[start])
        for name, start, end in _long_bones()
    }


def _neutral_spins(
    own: Joints, moves: dict[str, Float[Array, "coefficient 3"]], straight: Joints
) -> dict[str, Float[Array, "coefficient 3"]]:
    """How those turns change with the shape, as rotation vectors per unit of each coefficient.

    By differences: a turn depends on the joint centres alone, and these are linear in the shape.
    """
    neutral, spins = _neutral_turns(own, straight), {}
    for name, start, end in _long_bones():
        arrow, goal = own[end] - own[start], straight[end] - straight[start]
        turned = shortest_turn(arrow + _STEP * (moves[end] - moves[start]), goal)
        spins[name] = Rotation.from_matrix(turned @ neutral[name].T).as_rotvec() / _STEP
    return spins


def _long_bones() -> list[tuple[str, str, str]]:
    """Thighs and shanks with the joints at both their ends."""
    bones = (("femur", "hip", "knee"), ("tibia", "knee", "ankle"))
    return [(f"{bone}_{s}", f"{start}_{s}", f"{end}_{s}") for bone, start, end in bones for s in SIDES]


@cache
def _straight() -> Joints:
    """Joint centres of the skeleton's neutral pose, whose directions the straight legs have."""
    return skeleton_joints(skeleton_from_table(load_table()))
