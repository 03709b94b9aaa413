"""Which bone of the body model belongs to which body of the skeleton, and where its joints are.

The body model's bones carry MakeHuman's names, without the side (``.R``, ``.L``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hilbrace.skeleton.kinematics import Skeleton

Array = np.ndarray

SIDES = ("r", "l")
JOINTS = tuple(f"{joint}_{side}" for side in SIDES for joint in ("hip", "knee", "ankle"))

MIDLINE = ("pelvis", "torso")
LIMBS = ("femur", "tibia", "calcn", "toes", "humerus", "ulna", "radius", "hand")
BONES = (*MIDLINE, *(f"{body}_{side}" for side in SIDES for body in LIMBS))
"""The skeleton's bodies that carry skin; kneecap and talus ride on the bones around them."""

HIP_INWARD = 0.75
"""MakeHuman's hip lies 113 mm from the midline in the mean adult, a hip joint centre about 85 mm (Harrington
et al. 2007: a third of the pelvic width plus 7 mm)."""

_LUMBAR_SHARE = {"spine05": 0.0, "spine04": 0.3, "spine03": 0.7}
"""Share of the trunk in the vertebrae around the skeleton's one lumbar joint; the pelvis has the rest."""

_CARRIERS = (
    ("pelvis", "pelvis"),
    ("upperleg", "femur"),
    ("lowerleg", "tibia"),
    ("foot", "calcn"),
    ("toe", "toes"),
    ("upperarm", "humerus"),
    ("lowerarm01", "ulna"),
    ("lowerarm02", "radius"),
    ("wrist", "hand"),
    ("finger", "hand"),
    ("metacarpal", "hand"),
)


@dataclass(frozen=True)
class Segment:
    """A limb segment between two joint centres.

    Attributes:
        bones: Bodies of the skeleton that it is made of.
        start: Joint at its upper end.
        end: Joint at its lower end.
    """

    bones: tuple[str, ...]
    start: str
    end: str


SEGMENTS = (
    Segment(("femur",), "hip", "knee"),
    Segment(("tibia",), "knee", "ankle"),
    Segment(("humerus",), "shoulder", "elbow"),
    Segment(("ulna", "radius"), "elbow", "wrist"),
)
_HEADS = {
    "hip": "upperleg01",
    "knee": "lowerleg01",
    "ankle": "foot",
    "shoulder": "upperarm01",
    "elbow": "lowerarm01",
    "wrist": "wrist",
    "index": "finger2-1",
    "little": "finger5-1",
}
_ORIGINS = {
    "hip": "femur",
    "knee": "tibia",
    "ankle": "talus",
    "shoulder": "humerus",
    "elbow": "ulna",
    "wrist": "hand",
}


def makehuman_joints(
    bone_names: tuple[str, ...], heads: Float[Array, "*batch bone 3"]
) -> dict[str, Float[Array, "*batch 3"]]:
    """Joint centres by name and side (``"hip_r"``) from the heads of MakeHuman's bones [m].

    Linear in the heads. The hip is moved inward by `HIP_INWARD` and forward to above the knee, where it lies
    40 % of the depth of the pelvis behind its front: MakeHuman's is 30 mm further back, and the skeleton's
    markers on the pelvis then hang behind the skin.
    """
    joints = {
        f"{joint}_{side}": heads[..., bone_names.index(f"{bone}.{side.upper()}"), :]
        for side in SIDES
        for joint, bone in _HEADS.items()
    }
    for side in SIDES:
        hip, knee = joints[f"hip_{side}"], joints[f"knee_{side}"]
        joints[f"hip_{side}"] = np.stack([knee[..., 0], hip[..., 1], HIP_INWARD * hip[..., 2]], axis=-1)
    return joints


def skeleton_joints(skeleton: Skeleton) -> dict[str, Float[Array, " 3"]]:
    """The same joint centres of a skeleton in the neutral pose, pelvis at the origin [m]."""
    pose = skeleton.forward({})
    return {
        f"{joint}_{side}": pose[f"{body}_{side}"].origin[0]
        for side in SIDES
        for joint, body in _ORIGINS.items()
    }


def makehuman_shares(bone_names: tuple[str, ...]) -> Float[Array, "makehuman bone"]:
    """Share of each of MakeHuman's bones in the skeleton's bodies, in the order of `BONES`."""
    return np.array([_shares(name) for name in bone_names])


def _shares(bone: str) -> Float[Array, " bone"]:
    share = np.zeros(len(BONES))
    stem, _, side = bone.partition(".")
    if stem in _LUMBAR_SHARE or stem == "root":
        trunk = _LUMBAR_SHARE.get(stem, 0.0)
        share[BONES.index("torso")], share[BONES.index("pelvis")] = trunk, 1.0 - trunk
        return share
    body = next((body for prefix, body in _CARRIERS if stem.startswith(prefix)), "torso")
    share[BONES.index(body if body in MIDLINE else f"{body}_{side.lower()}")] = 1.0
    return share
