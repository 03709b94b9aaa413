"""The ``mesh`` body: a person's own surface, hung on the skeleton without a body model.

Each leg is carried by its thigh, shank and foot, parted by planes through the joint centres and then blended
by diffusion over the skin. All else (pelvis, trunk, arms) rides on pelvis and trunk.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from hilbrace.body.body import LooseSkin
from hilbrace.body.mesh_file import MeshSurface, read_mesh
from hilbrace.body.mesh_joints import SIDES, Joints, mesh_joints
from hilbrace.body.segments import BONES
from hilbrace.config import BodySettings
from hilbrace.errors import InputError

Array = np.ndarray

SAME_PERSON = 0.2
"""Difference of the mesh's height from the person's that still can be shoes, hair and error [-]."""
GROIN = np.deg2rad(40.0)
"""Slope of the plane between thigh and pelvis: it falls from the hip centre towards the crotch."""
KNEE_BLEND, ANKLE_BLEND = 0.20, 0.08
"""Half the length over which one bone takes over from the next, as a fraction of the shank; smoothed, this is
about what the embedded body has."""
TRUNK = 0.10
"""Height above the hips from which the skin is the trunk's [m]."""


def mesh_skin(target: Joints, height_m: float, settings: BodySettings) -> LooseSkin:
    """A mesh with its joints and weights.

    Args:
        target: Joint centres of the scaled skeleton in the neutral pose [m].
        height_m: The person's height [m]; 0 where unknown.
        settings: The file, its axes, unit, legs and landmarks.

    Raises:
        ConfigError: No file, or a landmark of unknown name.
        InputError: The file cannot be read, has another size, or hides where the joints are.
        GeometryError: The surface is damaged, or has no leg of the person.
    """
    surface = read_mesh(settings)
    both = settings.mesh_legs == "both"
    whole = float(np.ptp(surface.vertices[:, 1])) if surface.closed and both else 0.0
    if whole > 0.0 and height_m > 0.0 and abs(whole / height_m - 1.0) > SAME_PERSON:
        raise InputError(
            f"the closed mesh is {whole:.2f} m tall and the person {height_m:.2f} m",
            where=surface.where,
            hint="check body.mesh_units, body.mesh_up and subject.height_m; for one leg set body.mesh_legs",
        )
    joints = mesh_joints(surface, target, height_m, settings)
    return LooseSkin(
        model="mesh",
        shape=np.zeros(0),
        vertices=surface.vertices,
        triangles=surface.triangles,
        raw_weights=leg_weights(surface, joints, SIDES[settings.mesh_legs]),
        smoothed_on=surface.vertices,
        joints=joints,
        whole=whole > 0.0,
    )


def leg_weights(surface: MeshSurface, joints: Joints, sides: tuple[str, ...]) -> Float[Array, "vertex bone"]:
    """Weights of each vertex before smoothing.

    From one bone of a leg to the next they change linearly across a plane through the joint. At the knee it
    halves the angle between thigh and shank; at the ankle it slopes from above the heel to below the instep.

    Args:
        surface: The mesh.
        joints: Its joint centres [m].
        sides: Legs that it has, ``"r"`` and ``"l"``.

    Returns:
        Weights in the order of `hilbrace.body.segments.BONES`.
    """
    vertices = surface.vertices
    hips = np.mean([joints[f"hip_{side}"] for side in sides], axis=0)
    trunk = vertices[:, 1] > hips[1] + TRUNK
    weights = np.eye(len(BONES))[np.where(trunk, BONES.index("torso"), BONES.index("pelvis"))]
    middle = np.mean([joints[f"knee_{side}"][2] for side in sides]) if len(sides) == 2 else None
    for side in sides:
        hip, knee, ankle = (joints[f"{joint}_{side}"] for joint in ("hip", "knee", "ankle"))
        sign = 1.0 if side == "r" else -1.0
        own = (vertices - hip) @ np.array([0.0, np.cos(GROIN), -sign * np.sin(GROIN)]) < 0.0
        if middle is not None:
            own &= sign * (vertices[:, 2] - middle) > 0.0
        leg = _connected(surface.triangles, own, _nearest_in(vertices, own, knee))
        thigh, shank, length = _unit(hip - knee), _unit(knee - ankle), float(np.linalg.norm(knee - ankle))
        slope = _unit(2.0 * shank - np.array([1.0, 0.0, 0.0]))
        below_knee = _share_below((vertices - knee) @ _unit(thigh + shank), KNEE_BLEND * length)
        below_ankle = _share_below((vertices - ankle) @ slope, ANKLE_BLEND * length)
        shares = {
            "femur": 1.0 - below_knee,
            "tibia": below_knee * (1.0 - below_ankle),
            "calcn": below_knee * below_ankle,
        }
        weights[leg] = 0.0
        for name, share in shares.items():
            weights[leg, BONES.index(f"{name}_{side}")] = share[leg]
    return weights


def _share_below(height: Float[Array, " vertex"], half: float) -> Float[Array, " vertex"]:
    """Share of the bone below a joint: a ramp over ``half`` above and below the joint's plane [m]."""
    return np.clip(0.5 - height / (2.0 * half), 0.0, 1.0)


def _nearest_in(vertices: Float[Array, "vertex 3"], own: Bool[Array, " vertex"], point: Array) -> int:
    distance = np.linalg.norm(vertices - point, axis=1)
    return int(np.where(own, distance, np.inf).argmin())


def _connected(
    triangles: Int[Array, "triangle 3"], own: Bool[Array, " vertex"], seed: int
) -> Bool[Array, " vertex"]:
    """The vertices among ``own`` that are connected with one of them: hands beside the thighs are not."""
    inside = triangles[own[triangles].all(axis=1)]
    rows, columns = inside[:, [0, 1, 2]].ravel(), inside[:, [1, 2, 0]].ravel()
    links = sparse.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(own), len(own)))
    label = connected_components(links, directed=False)[1]
    return own & (label == label[seed])


def _unit(vector: Float[Array, " 3"]) -> Float[Array, " 3"]:
    return vector / np.linalg.norm(vector)
