"""The record that leaves the body stage: the subject's skin and segment sizes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray


@dataclass(frozen=True)
class Body:
    """A subject's body in the neutral pose (all joint angles zero), OpenSim axes.

    Attributes:
        model: Name of the body model: ``"anny-lite"``, ``"skel"``, ``"mesh"`` or ``"scan"``.
        mass_kg: Mass [kg].
        height_m: Height [m].
        scaled_bodies: Names of the skeleton's bodies.
        segment_scales: Scale of each body along its own axes against the default skeleton [-].
        shape: Shape coefficients of the body model [-].
        vertices: Skin in the neutral pose [m], pelvis origin of the scaled skeleton at the origin.
        triangles: Skin triangles, outward.
        bones: Names of the rigid bodies that carry the skin (names of the skeleton's bodies).
        bone_weights: Smoothed skinning weights [-]; rows sum to one.
        joint_names: ``hip_r, knee_r, ankle_r, hip_l, knee_l, ankle_l``.
        joint_centres: Joint centres in the neutral pose [m] (those of the scaled skeleton).
        fit_error_mm: How far the body model's own joint centres were from them before they were moved [mm];
            0 for joints of a leg that a scan lacks.
        height_error_mm: Height of the skin less the subject's height [mm]; 0 where the skin is a leg alone.
        skinning: ``"dual_quaternion"`` or ``"linear"``.
        weight_smoothing_mm: Diffusion length of the weights [mm].
    """

    model: str
    mass_kg: float
    height_m: float
    scaled_bodies: tuple[str, ...]
    segment_scales: Float[Array, "body 3"]
    shape: Float[Array, " coefficient"]
    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    bones: tuple[str, ...]
    bone_weights: Float[Array, "vertex bone"]
    joint_names: tuple[str, ...]
    joint_centres: Float[Array, "joint 3"]
    fit_error_mm: Float[Array, " joint"]
    height_error_mm: float
    skinning: str = "dual_quaternion"
    weight_smoothing_mm: float = 40.0


@dataclass(frozen=True)
class LooseSkin:
    """What a body model gives for one person, before it hangs on the skeleton.

    Attributes:
        model: Name of the model.
        shape: Its shape coefficients; none for a mesh.
        vertices: Skin in the model's own pose [m].
        triangles: Skin triangles, outward.
        raw_weights: Weights before smoothing, in the order of `hilbrace.body.segments.BONES`.
        smoothed_on: Skin over which the weights are smoothed [m]: of a model its mean person, so that all
            its bodies share them.
        joints: The model's own joint centres [m], by name and side.
        whole: False where the skin is a leg alone, which tells no height.
    """

    model: str
    shape: Float[Array, " coefficient"]
    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    raw_weights: Float[Array, "vertex bone"]
    smoothed_on: Float[Array, "vertex 3"]
    joints: dict[str, Float[Array, " 3"]]
    whole: bool


@dataclass(frozen=True)
class ScannedBody:
    """A body fitted to a scan, in the model's own pose; what ``hilbrace scan fit`` leaves for the body stage.

    Attributes:
        model: Name of the body model that was fitted.
        sides: Legs that the scan showed, ``"l"`` and ``"r"``; the rest is the model's.
        shape: Shape coefficients of the model.
        vertices: Skin with the free displacement [m], OpenSim axes.
        triangles: Skin triangles, outward.
        raw_weights: Weights before smoothing, in the order of `hilbrace.body.segments.BONES`.
        smoothed_on: Skin of the mean person, over which weights are smoothed [m].
        joint_names: Names of the joints, ``knee_l`` and so on.
        joint_centres: Their centres [m].
    """

    model: str
    sides: tuple[str, ...]
    shape: Float[Array, " coefficient"]
    vertices: Float[Array, "vertex 3"]
    triangles: Int[Array, "triangle 3"]
    raw_weights: Float[Array, "vertex bone"]
    smoothed_on: Float[Array, "vertex 3"]
    joint_names: tuple[str, ...]
    joint_centres: Float[Array, "joint 3"]
