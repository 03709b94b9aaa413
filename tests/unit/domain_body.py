"""A synthetic body with two bent legs, for the tests of the design domain."""

from __future__ import annotations

import dataclasses
from functools import cache

import manifold3d
import numpy as np

from hilbrace.body.body import Body

JOINTS = ("hip_r", "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l")
BONES = ("pelvis", "femur_r", "tibia_r", "calcn_r", "femur_l", "tibia_l", "calcn_l")
HIP = np.array([-0.05, -0.08, 0.10])
KNEE = np.array([-0.055, -0.50, 0.11])
ANKLE = np.array([-0.06, -0.90, 0.115])
CALF_TOP, CALF_END = np.array([-0.08, -0.60, 0.11]), np.array([-0.085, -0.68, 0.11])
PATELLA_TOP, PATELLA_END = np.array([-0.025, -0.495, 0.11]), np.array([-0.025, -0.505, 0.11])
HEEL, TOE = np.array([-0.09, -0.94, 0.115]), np.array([0.08, -0.95, 0.125])
LEFT = np.array([1.0, 1.0, -1.0])


LOW = np.array([-0.30, -1.05, -0.40])
HIGH = np.array([0.30, 0.65, 0.40])
STEP = 0.01


def cone_distance(points, start, end, radius_start, radius_end):
    """Distance to a round cone (close enough to make a mesh)."""
    axis = end - start
    part = np.clip((points - start) @ axis / (axis @ axis), 0.0, 1.0)
    away = points - start - part[..., None] * axis
    return np.linalg.norm(away, axis=-1) - (radius_start + part * (radius_end - radius_start))


def body_distance(points):
    """Smooth union of cones: positive inside."""
    half = points * [1.0, 1.0, np.nan]
    half[..., 2] = np.abs(points[..., 2])
    parts = [
        cone_distance(half, HIP, KNEE, 0.085, 0.058),
        cone_distance(half, KNEE, ANKLE, 0.056, 0.036),
        cone_distance(half, CALF_TOP, CALF_END, 0.048, 0.042),
        cone_distance(half, PATELLA_TOP, PATELLA_END, 0.035, 0.035),
        cone_distance(half, HEEL, TOE, 0.035, 0.03),
        cone_distance(half, np.zeros(3), np.array([0.0, 0.4, 0.0]), 0.16, 0.17),
    ]
    return 0.015 * np.log(np.sum([np.exp(-part / 0.015) for part in parts], axis=0))


def tabulated(function):
    """The function read from a table of STEP, fast enough for a callback per point."""
    axes = [np.arange(low - 0.05, high + 0.05, STEP) for low, high in zip(LOW, HIGH, strict=True)]
    table = function(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    rows, columns = table.shape[1] * table.shape[2], table.shape[2]
    flat = table.ravel().tolist()
    x0, y0, z0 = (LOW - 0.05).tolist()

    def look_up(x, y, z):
        i, j, k = (x - x0) / STEP, (y - y0) / STEP, (z - z0) / STEP
        a, b, c = int(i), int(j), int(k)
        i, j, k = i - a, j - b, k - c
        at = a * rows + b * columns + c
        near = (flat[at] * (1 - k) + flat[at + 1] * k) * (1 - j)
        near += (flat[at + columns] * (1 - k) + flat[at + columns + 1] * k) * j
        at += rows
        far = (flat[at] * (1 - k) + flat[at + 1] * k) * (1 - j)
        far += (flat[at + columns] * (1 - k) + flat[at + columns + 1] * k) * j
        return near * (1 - i) + far * i

    return look_up


@cache
def synthetic_body(edge_m: float = 0.022) -> Body:
    """Torso, two legs with a patella bulge and a calf, two feet; closed and connected."""
    solid = manifold3d.Manifold.level_set(tabulated(body_distance), [*LOW, *HIGH], edge_m)
    mesh = solid.to_mesh()
    vertices = np.asarray(mesh.vert_properties, float)[:, :3]
    triangles = np.asarray(mesh.tri_verts, np.int64)
    centres = np.array([HIP, KNEE, ANKLE, HIP * LEFT, KNEE * LEFT, ANKLE * LEFT])
    return make_body(vertices, triangles, centres)


def make_body(vertices, triangles, centres) -> Body:
    weights = np.stack([bone_weight(vertices, bone, centres) for bone in BONES], axis=1)
    return Body(
        model="synthetic",
        mass_kg=70.0,
        height_m=1.7,
        scaled_bodies=BONES,
        segment_scales=np.ones((len(BONES), 3)),
        shape=np.zeros(1),
        vertices=vertices,
        triangles=triangles,
        bones=BONES,
        bone_weights=weights / weights.sum(axis=1, keepdims=True),
        joint_names=JOINTS,
        joint_centres=centres,
        fit_error_mm=np.zeros(6),
        height_error_mm=0.0,
    )


def bone_weight(vertices, bone, centres):
    """Weights that change over 60 mm at the joints."""
    height = vertices[:, 1]
    ramp = lambda at: 1.0 / (1.0 + np.exp(-(height - at) / 0.03))  # noqa: E731
    if bone == "pelvis":
        return ramp(centres[0, 1])
    side = vertices[:, 2] >= 0.0 if bone.endswith("r") else vertices[:, 2] < 0.0
    hip, knee, ankle = centres[:3, 1]
    parts = {
        "femur": (1 - ramp(hip)) * ramp(knee),
        "tibia": (1 - ramp(knee)) * ramp(ankle),
        "calcn": 1 - ramp(ankle),
    }
    return side * parts[bone[:5]]


def mirrored_body(body: Body) -> Body:
    """The same body seen in the mirror: left and right change places."""
    swap = {"r": "l", "l": "r"}
    renamed = tuple(name[:-1] + swap[name[-1]] if name[-2] == "_" else name for name in body.bones)
    order = [renamed.index(name) for name in body.bones]
    joints = tuple(name[:-1] + swap[name[-1]] for name in body.joint_names)
    return dataclasses.replace(
        body,
        vertices=body.vertices * LEFT,
        triangles=np.ascontiguousarray(body.triangles[:, [0, 2, 1]]),
        bone_weights=body.bone_weights[:, order],
        joint_centres=(body.joint_centres * LEFT)[[joints.index(name) for name in body.joint_names]],
    )
