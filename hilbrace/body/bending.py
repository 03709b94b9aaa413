"""Does the skin around a knee stay whole when the knee bends?"""

from __future__ import annotations

import igl
import numpy as np
from jaxtyping import Float, Int

from hilbrace.body.body import Body
from hilbrace.body.posing import bone_transforms
from hilbrace.body.segments import SIDES
from hilbrace.body.skinning import SKINNINGS, bind, one_leg

Array = np.ndarray

FLEXION = np.deg2rad(110.0)
"""Flexion at which the skin is tried: a deep squat or landing [rad]."""
LEAST, MOST = 0.28, 2.10
"""Area ratios that a triangle may have there [-]; finer meshes then stay within 0.25 and 2.2."""
ABOVE, BELOW = 0.42, 0.40
"""Part of the thigh and of the shank that is tried."""


def bends_whole(body: Body) -> bool:
    """Do the triangles around both knees keep their area within `LEAST` and `MOST` at `FLEXION`?

    A leg that the skin lacks is not tried.
    """
    ratios = [knee_area_ratios(body, side) for side in SIDES]
    return all(ratio.min() >= LEAST and ratio.max() <= MOST for ratio in ratios if len(ratio))


def knee_area_ratios(body: Body, side: str, flexion: float = float(FLEXION)) -> Float[Array, " triangle"]:
    """Area of small triangles around a bent knee over their area in the neutral pose [-].

    Args:
        body: The body.
        side: ``"r"`` or ``"l"``.
        flexion: Flexion of the knee [rad].
    """
    triangles = knee_triangles(body, side)
    if not len(triangles):
        return np.ones(0)
    used, flat = np.unique(triangles, return_inverse=True)
    points, fine = map(np.asarray, igl.upsample(body.vertices[used], flat.reshape(-1, 3).astype(np.int64), 1))
    rotations, translations = bone_transforms(body, [f"knee_angle_{side}"], np.array([[flexion]]))
    posed = SKINNINGS[body.skinning](points, bind(points, one_leg(body, side)), rotations, translations)[0]
    return np.asarray(igl.doublearea(posed, fine)) / np.asarray(igl.doublearea(points, fine))


def knee_triangles(body: Body, side: str) -> Int[Array, "triangle 3"]:
    """Triangles of the skin from `ABOVE` to `BELOW` the knee."""
    hip, knee, ankle = (
        body.joint_centres[body.joint_names.index(f"{joint}_{side}")] for joint in ("hip", "knee", "ankle")
    )
    bones = [body.bones.index(f"{bone}_{side}") for bone in ("femur", "tibia")]
    leg = body.bone_weights[:, bones].sum(axis=1) > 0.5
    up = body.vertices[:, 1] - knee[1]
    near = leg & (up < ABOVE * (hip - knee)[1]) & (up > -BELOW * (knee - ankle)[1])
    return body.triangles[near[body.triangles].all(axis=1)]
