"""The body stage: the subject's skin in the neutral pose, on the skeleton scaled to the subject."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.body import fit
from hilbrace.body.anny_lite import AnnyLite, load_anny_lite
from hilbrace.body.body import Body
from hilbrace.body.neutral import joint_distances, place
from hilbrace.body.segments import BONES, JOINTS, bone_weights, model_joints, skeleton_joints
from hilbrace.body.skinning import smoothed_weights
from hilbrace.config import BodySettings
from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import read_marker_map
from hilbrace.motion.trial import Trial
from hilbrace.skeleton.kinematics import skeleton_from_table
from hilbrace.skeleton.scaling import scaled_table, segment_scales
from hilbrace.skeleton.table import load_table
from hilbrace.units import MM_PER_M

Array = np.ndarray
Scales = dict[str, Float[Array, " 3"]]

ROUNDS = 3
"""Fits of the shape: height and volume change a little on the way to the neutral pose."""


def build_body(trial: Trial, settings: BodySettings) -> Body:
    """The body of the person who stands in a trial.

    Args:
        trial: A recording with standing markers.
        settings: Settings of the skin.

    Raises:
        InputError: No standing marker is a landmark of the skeleton, or the mass is unknown.
    """
    landmarks = standing_landmarks(trial)
    scales = segment_scales(landmarks, load_table(), trial.height_m)
    return body_of(scales, trial.mass_kg, trial.height_m, settings)


def standing_landmarks(trial: Trial) -> dict[str, Float[Array, " 3"]]:
    """Standing markers by their names in the skeleton's table [m]; hidden ones are left out."""
    names = read_marker_map(trial.marker_map).landmarks
    seen = zip(trial.static_marker_names, trial.static_markers, strict=True)
    return {names[name]: place for name, place in seen if name in names and np.isfinite(place).all()}


def body_of(scales: Scales, mass_kg: float, height_m: float, settings: BodySettings) -> Body:
    """The body of a person given by figures.

    Args:
        scales: Scale of each body of the skeleton along its axes [-].
        mass_kg: Mass [kg].
        height_m: Height [m]; 0 where unknown, then the segment lengths decide.
        settings: Settings of the skin.

    Raises:
        InputError: The mass is unknown.
    """
    if not mass_kg > 0.0:
        raise InputError(
            "the subject's mass is unknown",
            where="body stage",
            hint="set subject.mass_kg in the configuration",
        )
    model = load_anny_lite()
    target = skeleton_joints(skeleton_from_table(scaled_table(load_table(), scales, mass_kg)))
    weights = _weights(model, settings)
    shape, vertices = _fitted(model, weights, target, mass_kg, height_m)
    height = float(np.ptp(vertices[:, 1]))
    return Body(
        model="anny-lite",
        mass_kg=mass_kg,
        height_m=height_m if height_m > 0.0 else height,
        scaled_bodies=tuple(scales),
        segment_scales=np.stack([np.asarray(scale, dtype=float) for scale in scales.values()]),
        shape=shape,
        vertices=vertices,
        triangles=model.triangles.copy(),
        bones=BONES,
        bone_weights=weights,
        joint_names=JOINTS,
        joint_centres=np.stack([target[name] for name in JOINTS]),
        fit_error_mm=joint_distances(model_joints(model, model.heads(shape)), target) * MM_PER_M,
        height_error_mm=(height - height_m) * MM_PER_M if height_m > 0.0 else 0.0,
    )


def _weights(model: AnnyLite, settings: BodySettings) -> Float[Array, "vertex bone"]:
    """Smoothed on the mean adult, so that all bodies share them."""
    raw = bone_weights(model)
    return smoothed_weights(model.template, model.triangles, raw, settings.weight_smoothing_mm / MM_PER_M)


def _fitted(
    model: AnnyLite,
    weights: Float[Array, "vertex bone"],
    target: dict[str, Float[Array, " 3"]],
    mass_kg: float,
    height_m: float,
) -> tuple[Float[Array, " coefficient"], Float[Array, "vertex 3"]]:
    """Shape and neutral skin, whose height and volume are those wanted."""
    lengths, volume_m3 = fit.target_figures(target), mass_kg / fit.DENSITY
    asked_height, asked_volume = height_m, volume_m3
    shape, vertices = np.zeros(len(model.coefficient_names)), model.template
    for _ in range(ROUNDS):
        shape = fit.fit_shape(model, lengths, asked_height if height_m > 0.0 else None, asked_volume)
        placement = place(model_joints(model, model.heads(shape)), target)
        vertices = placement.apply(model.vertices(shape), weights)
        asked_height += height_m - float(np.ptp(vertices[:, 1]))
        asked_volume *= volume_m3 / fit.enclosed_volume(vertices, model.triangles)[0]
    return shape, vertices
