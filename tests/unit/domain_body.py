"""A synthetic body with two bent legs, for the tests of the design domain."""

from __future__ import annotations

import dataclasses
from functools import cache

import manifold3d
import numpy as np

from hilbrace.biomech.joint_loads import JOINTS as JOINT_ORDER
from hilbrace.biomech.joint_loads import JointLoads, without_muscles
from hilbrace.body.body import Body
from hilbrace.body.skinning import smoothed_weights
from hilbrace.config import DomainSettings
from hilbrace.domain.limb import Limb

JOINTS = ("hip_r", "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l")
BONES = ("pelvis", "femur_r", "tibia_r", "calcn_r", "femur_l", "tibia_l", "calcn_l")
LEFT = np.array([1.0, 1.0, -1.0])

# Joint centres of the built-in skeleton at its default size [m].
HIP = np.array([-0.0563, -0.0785, 0.0773])
KNEE = np.array([-0.0563, -0.4829, 0.0760])
ANKLE = np.array([-0.0663, -0.8829, 0.0760])

CONES = (
    (HIP, KNEE, 0.070, 0.046),
    (KNEE, ANKLE, 0.045, 0.034),
    (KNEE + np.array([-0.02, -0.10, 0.0]), KNEE + np.array([-0.025, -0.18, 0.0]), 0.042, 0.038),
    (KNEE + np.array([0.03, 0.005, 0.0]), KNEE + np.array([0.03, -0.005, 0.0]), 0.035, 0.035),
    (ANKLE + np.array([-0.03, -0.04, 0.0]), ANKLE + np.array([0.14, -0.05, 0.01]), 0.035, 0.030),
    (np.array([-0.05, 0.0, 0.0]), np.array([-0.05, 0.4, 0.0]), 0.15, 0.17),
)
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
    parts = [cone_distance(half, *cone) for cone in CONES]
    return 0.01 * np.log(np.sum([np.exp(-part / 0.01) for part in parts], axis=0))


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
    weights = np.stack([belongs(vertices, bone, centres) for bone in BONES], axis=1).astype(float)
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
        bone_weights=smoothed_weights(vertices, triangles, weights, 0.06),
        joint_names=JOINTS,
        joint_centres=centres,
        fit_error_mm=np.zeros(6),
        height_error_mm=0.0,
    )


def belongs(vertices, bone, centres):
    """True where a vertex lies at the height of a bone, on its side."""
    hip, knee, ankle = centres[:3, 1]
    height = vertices[:, 1]
    if bone == "pelvis":
        return height >= hip
    low, high = {"femur": (knee, hip), "tibia": (ankle, knee), "calcn": (-np.inf, ankle)}[bone[:5]]
    side = vertices[:, 2] >= 0.0 if bone.endswith("r") else vertices[:, 2] < 0.0
    return side & (height >= low) & (height < high)


def bending(body: Body, flexion_deg, side="left", **others) -> JointLoads:
    """Loads of a motion that bends the knee through the angles given, at 100 frames a second."""
    flexion = np.radians(np.asarray(flexion_deg, float))
    names = (f"knee_angle_{side[0]}", *others)
    columns = [flexion, *(np.broadcast_to(value, flexion.shape) for value in others.values())]
    frames = len(flexion)
    angles = np.zeros((frames, 4, 3))
    angles[:, JOINT_ORDER.index(f"knee_{side[0]}"), 0] = flexion
    force = np.zeros((frames, 4, 3))
    force[:, :, 1] = -700.0 - 100.0 * np.sin(np.arange(frames))[:, None]
    return JointLoads(
        time=np.arange(frames) / 100.0,
        body_mass_kg=body.mass_kg,
        coordinate_names=names,
        coordinates=np.stack(columns, axis=1),
        muscles=80,
        joints=JOINT_ORDER,
        angles=angles,
        distal_rotation=np.broadcast_to(np.eye(3), (frames, 4, 3, 3)),
        joint_axes=np.broadcast_to(np.eye(3), (frames, 4, 3, 3)),
        acting_force=force,
        acting_moment=np.zeros((frames, 4, 3)),
        convention="intersegmental",
        inertia=np.broadcast_to(np.eye(3), (frames, 4, 3, 3)),
        distal_jacobian=np.zeros((frames, 4, 6, 3)),
        marker_names=(),
        marker_error=np.zeros((frames, 0)),
        cutoff_hz=12.0,
        pelvis_residual_force=np.zeros((frames, 3)),
        **without_muscles(frames, 4, len(names)),
    )


def domain_settings(**keys: object) -> DomainSettings:
    """Section ``domain`` from keys as they are written in a configuration."""
    return DomainSettings.model_validate(keys)


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


def sleeve(radius_low, radius_high, height, around=24, along=12, uneven=0.0):
    """A prism or a pyramid's frustum about the y axis, welded, outward: a developable surface."""
    turn, level = np.meshgrid(np.arange(around), np.arange(along + 1), indexing="ij")
    angle = 2.0 * np.pi * (turn + uneven * np.sin(3.0 * level + turn)) / around
    share = level / along
    radius = radius_low + share * (radius_high - radius_low)
    points = np.stack([radius * np.cos(angle), share * height, radius * np.sin(angle)], axis=-1)
    number = lambda i, j: (i % around) * (along + 1) + j  # noqa: E731
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(around), np.arange(along), indexing="ij"))
    first = np.stack([number(i, j), number(i, j + 1), number(i + 1, j)], axis=1)
    second = np.stack([number(i + 1, j), number(i, j + 1), number(i + 1, j + 1)], axis=1)
    return points.reshape(-1, 3), np.concatenate([first, second]).astype(np.int64)


def upright_limb() -> Limb:
    """A leg along the y axis."""
    return Limb(
        name="knee",
        side="right",
        upper=np.array([0.0, 400.0, 0.0]),
        lower=np.array([0.0, -400.0, 0.0]),
        distal=np.array([0.0, -1.0, 0.0]),
        other=np.full(3, -200.0),
        centre_m=np.zeros(3),
    )


def outwardness(vertices, triangles):
    """Share of triangles whose normal points away from the y axis."""
    corner = vertices[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    centre = corner.mean(axis=1)
    return np.mean((normal * centre)[:, [0, 2]].sum(axis=1) > 0.0)
