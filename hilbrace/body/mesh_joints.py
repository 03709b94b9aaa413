"""Joint centres inside a person's mesh: from landmarks, and from the skeleton scaled to the person.

What no landmark tells is found at the skeleton's segment lengths: knee and ankle in the middle of the leg's
cross-section at their height, the hip above the knee at half the skeleton's distance between the hips.
"""

from __future__ import annotations

import difflib
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from hilbrace.body.mesh_file import MeshSurface
from hilbrace.body.segments import JOINTS
from hilbrace.config import BodySettings
from hilbrace.errors import ConfigError, GeometryError, InputError
from hilbrace.units import MM_PER_M

Array = np.ndarray
Joints = dict[str, Float[Array, " 3"]]

ANKLE_HEIGHT, HIP_HEIGHT = 0.039, 0.530
"""Heights of ankle and hip above the sole as fractions of the body's height (Winter, "Biomechanics and motor
control of human movement", 4th ed. 2009, fig. 4.1)."""
SHORTEST_FOOT = 0.09
"""Length below the ankle from which the end of the mesh is a foot, as a fraction of the height [-]."""
KNEE_ACROSS = (0.06, 0.26)
"""Diameters between which a knee's cross-section lies [m]."""
STRETCH = (0.75, 1.33)
"""Lengths of a segment in the mesh over the skeleton's that still can be one person's [-]."""

SIDES = {"both": ("r", "l"), "right": ("r",), "left": ("l",)}
_PAIR = ("lateral", "medial")
LANDMARKS = (*JOINTS, *(f"{joint}_{side}" for joint in JOINTS for side in _PAIR))
"""Names that ``body.landmarks`` may hold."""


class Section(NamedTuple):
    """One closed cross-section of a mesh."""

    centre: Float[Array, " 3"]
    area: float


def height_of_leg(hip_to_ankle: float) -> float:
    """Height of a person whose hip and ankle centres are a distance apart [m]."""
    return hip_to_ankle / (HIP_HEIGHT - ANKLE_HEIGHT)


def landmark_joints(settings: BodySettings, surface: MeshSurface) -> Joints:
    """Joint centres that the landmarks tell [m]: given themselves, or half-way between both sides.

    Raises:
        ConfigError: A name is unknown, or one of a pair is missing.
    """
    places = {name: surface.frame.inwards(np.array(point)) for name, point in settings.landmarks.items()}
    for name in places:
        if name not in LANDMARKS:
            near = difflib.get_close_matches(name, LANDMARKS, n=1)
            raise ConfigError(
                f"no landmark is called '{name}'",
                where="body.landmarks",
                hint=f"did you mean '{near[0]}'?" if near else f"use {', '.join(LANDMARKS)}",
            )
    joints = {name: place for name, place in places.items() if name in JOINTS}
    for joint in JOINTS:
        pair = [places.get(f"{joint}_{side}") for side in _PAIR]
        if pair[0] is not None and pair[1] is not None:
            joints.setdefault(joint, (pair[0] + pair[1]) / 2.0)
        elif pair[0] is not None or pair[1] is not None:
            raise ConfigError(
                f"{joint} has a landmark on one side only",
                where="body.landmarks",
                hint=f"give both {joint}_lateral and {joint}_medial, or {joint} itself",
            )
    return joints


def mesh_joints(surface: MeshSurface, target: Joints, height_m: float, settings: BodySettings) -> Joints:
    """Hips, knees and ankles of the legs that a mesh has [m].

    Args:
        surface: The mesh, standing.
        target: Joint centres of the scaled skeleton in the neutral pose [m].
        height_m: The person's height [m]; 0 where unknown.
        settings: Landmarks and legs.

    Raises:
        ConfigError: A landmark has an unknown name.
        InputError: Without landmarks nothing tells where the joints are.
        GeometryError: The mesh has no leg there, or segments of another length than the person's.
    """
    given = landmark_joints(settings, surface)
    sides = SIDES[settings.mesh_legs]
    joints: Joints = {}
    for side in sides:
        own = {n.split("_")[0]: place for n, place in given.items() if n.endswith(f"_{side}")}
        thigh, shank = (
            float(np.linalg.norm(target[f"{a}_{side}"] - target[f"{b}_{side}"]))
            for a, b in (("hip", "knee"), ("knee", "ankle"))
        )
        if not own.keys() & {"knee", "ankle"}:
            height = height_m if height_m > 0.0 else height_of_leg(thigh + shank)
            own["ankle"] = _ankle_above_sole(surface, height, side, len(sides))
        if "knee" not in own:
            own["knee"] = _middle_at(surface, own["ankle"], shank)
        if "ankle" not in own:
            own["ankle"] = _middle_at(surface, own["knee"], -shank)
        joints |= {f"{name}_{side}": place for name, place in own.items()}
        _check_knee(surface, own["knee"], side)
    _add_hips(joints, target, sides)
    _check_lengths(joints, target, sides, surface)
    return joints


def sections_at(surface: MeshSurface, height: float) -> list[Section]:
    """Closed curves in which a horizontal plane cuts the mesh, by their centroids and areas.

    Args:
        surface: The mesh.
        height: Height of the plane [m]; moved by a nanometre, so that it meets no vertex.
    """
    above = surface.vertices[:, 1] > height + 1e-9
    cut = surface.triangles[above[surface.triangles].any(axis=1) & ~above[surface.triangles].all(axis=1)]
    if not len(cut):
        return []
    lone = above[cut] == (above[cut].sum(axis=1) == 1)[:, None]
    first = lone.argmax(axis=1)
    tip, after, before = (cut[np.arange(len(cut)), (first + k) % 3] for k in range(3))
    start, end = (_crossing(surface.vertices, tip, other, height + 1e-9) for other in (after, before))
    flip = ~above[tip]
    start[flip], end[flip] = end[flip], start[flip].copy()
    label = _loops(tip, after, before)
    found = []
    for loop in np.unique(label):
        p, q = start[label == loop], end[label == loop]
        origin = p.mean(axis=0)
        cross = (p[:, 2] - origin[2]) * (q[:, 0] - origin[0]) - (p[:, 0] - origin[0]) * (q[:, 2] - origin[2])
        area = float(cross.sum()) / 2.0
        if abs(area) > 1e-9:
            centre = origin + ((p + q - 2.0 * origin) * cross[:, None]).sum(axis=0) / (6.0 * area)
            found.append(Section(np.array([centre[0], height, centre[2]]), abs(area)))
    return found


def _crossing(
    vertices: Float[Array, "vertex 3"], tip: Array, other: Array, height: float
) -> Float[Array, "cut 3"]:
    a, b = vertices[tip], vertices[other]
    share = (height - a[:, 1]) / (b[:, 1] - a[:, 1])
    return a + share[:, None] * (b - a)


def _loops(tip: Array, after: Array, before: Array) -> Array:
    """Number of the curve that each cut triangle belongs to: triangles that share a cut edge are on one."""
    edges = np.sort(np.concatenate([np.column_stack([tip, after]), np.column_stack([tip, before])]), axis=1)
    place = np.unique(edges, axis=0, return_inverse=True)[1].reshape(2, -1)
    count = int(place.max()) + 1
    links = sparse.coo_matrix((np.ones(place.shape[1]), (place[0], place[1])), shape=(count, count))
    return connected_components(links, directed=False)[1][place[0]]


def _ankle_above_sole(surface: MeshSurface, height: float, side: str, legs: int) -> Float[Array, " 3"]:
    """Ankle centre over the sole, where the mesh ends in a foot."""
    vertices = surface.vertices
    middle = (vertices[:, 2].min() + vertices[:, 2].max()) / 2.0
    sign = 1.0 if side == "r" else -1.0
    own = vertices if legs == 1 else vertices[sign * (vertices[:, 2] - middle) > 0.0]
    low = float(own[:, 1].min())
    foot = own[own[:, 1] < low + ANKLE_HEIGHT * height]
    sections = sections_at(surface, low + ANKLE_HEIGHT * height)
    if legs > 1:
        sections = [one for one in sections if sign * (one.centre[2] - middle) > 0.0]
    if not sections or np.ptp(foot[:, 0]) < SHORTEST_FOOT * height:
        raise InputError(
            "the mesh does not end in a foot, so that nothing tells where the knee is",
            where=surface.where,
            hint=f"set body.landmarks.knee_{side} in the file's axes and unit, or mend body.mesh_units, "
            "body.mesh_up and body.mesh_forward",
        )
    ankle = max(sections, key=lambda one: one.area).centre
    if foot[:, 0].max() - ankle[0] < ankle[0] - foot[:, 0].min():
        raise InputError(
            f"the toes of the mesh point backward (side {side})",
            where=surface.where,
            hint="turn body.mesh_forward round, or check body.mesh_up",
        )
    return ankle


def _middle_at(surface: MeshSurface, known: Float[Array, " 3"], rise: float) -> Float[Array, " 3"]:
    """Middle of the leg at a height above a known centre; straight above or below it where the mesh ends."""
    straight = known + np.array([0.0, rise, 0.0])
    sections = sections_at(surface, float(straight[1]))
    if not sections:
        return straight
    near = min(sections, key=lambda one: float(np.linalg.norm(one.centre - straight)))
    offset = near.centre - straight
    return straight if np.linalg.norm(offset) > 0.5 * abs(rise) else near.centre


def _check_knee(surface: MeshSurface, knee: Float[Array, " 3"], side: str) -> None:
    sections = sections_at(surface, float(knee[1]))
    if not sections:
        raise GeometryError(
            f"the mesh has no surface around knee_{side} at {surface.frame.named(knee)}",
            where=surface.where,
            hint="check body.landmarks, body.mesh_legs, body.mesh_up and body.mesh_units",
        )
    near = min(sections, key=lambda one: float(np.linalg.norm(one.centre - knee)))
    across = 2.0 * float(np.sqrt(near.area / np.pi))
    if not KNEE_ACROSS[0] <= across <= KNEE_ACROSS[1] or np.linalg.norm(near.centre - knee) > across:
        raise GeometryError(
            f"around knee_{side} the mesh is {across * MM_PER_M:.0f} mm thick and "
            f"{np.linalg.norm(near.centre - knee) * MM_PER_M:.0f} mm away: no knee",
            where=surface.where,
            hint="check body.mesh_units, body.landmarks and body.mesh_legs",
        )


def _add_hips(joints: Joints, target: Joints, sides: tuple[str, ...]) -> None:
    """Hips that no landmark tells, above the knees at the length of the skeleton's thigh."""
    middle = float(np.mean([joints[f"knee_{side}"][2] for side in sides])) if len(sides) == 2 else None
    for side in sides:
        name, knee = f"hip_{side}", joints[f"knee_{side}"]
        if name in joints:
            continue
        thigh = float(np.linalg.norm(target[name] - target[f"knee_{side}"]))
        across = 0.0 if middle is None else middle + target[name][2] - knee[2]
        rise = np.sqrt(max(thigh**2 - across**2, (0.5 * thigh) ** 2))
        joints[name] = knee + np.array([0.0, rise, across])


def _check_lengths(joints: Joints, target: Joints, sides: tuple[str, ...], surface: MeshSurface) -> None:
    for side in sides:
        for first, last, segment in (("hip", "knee", "thigh"), ("knee", "ankle", "shank")):
            own, wanted = (
                float(np.linalg.norm(place[f"{first}_{side}"] - place[f"{last}_{side}"]))
                for place in (joints, target)
            )
            if not STRETCH[0] <= own / wanted <= STRETCH[1]:
                raise GeometryError(
                    f"the {segment} ({side}) is {own * MM_PER_M:.0f} mm long in the mesh and "
                    f"{wanted * MM_PER_M:.0f} mm in the person's skeleton",
                    where=surface.where,
                    hint="check body.landmarks and body.mesh_units; mesh and motion must be of one person",
                )
