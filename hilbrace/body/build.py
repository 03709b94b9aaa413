"""The body stage: the subject's skin in the neutral pose, on the skeleton scaled to the subject."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from hilbrace.body import fit
from hilbrace.body.anny_lite import load_anny_lite
from hilbrace.body.bending import bends_whole
from hilbrace.body.body import Body, LooseSkin
from hilbrace.body.mesh import mesh_skin
from hilbrace.body.mesh_joints import height_of_leg
from hilbrace.body.model import BodyModel
from hilbrace.body.neutral import joint_distances, place
from hilbrace.body.scanned import scanned_skin
from hilbrace.body.segments import BONES, JOINTS, skeleton_joints
from hilbrace.body.skel import load_skel
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

MARKER_RADIUS = 0.007
"""Distance from the skin to the middle of a marker of the usual 14 mm [m]."""

_ACROSS = {"knee": ("LFC", "MFC"), "ankle": ("LMAL", "MMAL")}

SMOOTHING_MM = (40.0, 50.0, 60.0, 70.0, 80.0)
"""Diffusion lengths of the weights [mm]: the first with which a bent knee stays whole is taken. 40 mm serves
people of ordinary build; short and heavy legs need more."""

ROUNDS = 3
"""Fits of the shape: height and volume change a little on the way to the neutral pose."""


def build_body(trial: Trial, settings: BodySettings) -> Body:
    """The body of the person in a trial, measured while standing, or in the motion where nobody stands.

    Args:
        trial: A recording.
        settings: Settings of the skin.

    Raises:
        InputError: No marker is a landmark of the skeleton, or the mass is unknown.
    """
    landmarks = standing_landmarks(trial) if trial.static_marker_names else moving_landmarks(trial)
    scales = segment_scales(landmarks, load_table(), trial.height_m)
    return body_of(scales, trial.mass_kg, trial.height_m, settings, joint_breadths(landmarks))


def standing_landmarks(trial: Trial) -> dict[str, Float[Array, " 3"]]:
    """Standing markers by their names in the skeleton's table [m]; hidden ones are left out."""
    names = read_marker_map(trial.marker_map).landmarks
    seen = zip(trial.static_marker_names, trial.static_markers, strict=True)
    return {names[name]: place for name, place in seen if name in names and np.isfinite(place).all()}


def moving_landmarks(trial: Trial) -> dict[str, Float[Array, "frame 3"]]:
    """Markers of a motion by their names in the skeleton's table [m], one place per surveyed frame."""
    names = read_marker_map(trial.marker_map).landmarks
    markers = trial.markers_to_measure()
    return {names[name]: markers[:, k] for k, name in enumerate(trial.marker_names) if name in names}


def joint_breadths(landmarks: dict[str, Float[Array, "... 3"]]) -> dict[str, float]:
    """Breadths across knees and ankles [m] where markers on both sides of the joint were worn.

    Args:
        landmarks: Markers by their names in the skeleton's table [m], one place or one per frame.

    Returns:
        Figures of `hilbrace.body.fit.measure`; the mean of both legs, less the markers' own size.
    """
    breadths = {}
    for joint, (outer, inner) in _ACROSS.items():
        pairs = [(landmarks.get(s + outer), landmarks.get(s + inner)) for s in "RL"]
        gaps = [np.linalg.norm(a - b, axis=-1) for a, b in pairs if a is not None and b is not None]
        seen = [
            float(np.median(gap[np.isfinite(gap)]))
            for gap in map(np.atleast_1d, gaps)
            if np.isfinite(gap).any()
        ]
        if seen:
            breadths[f"{joint} breadth"] = float(np.mean(seen)) - 2.0 * MARKER_RADIUS
    return breadths


def body_of(
    scales: Scales,
    mass_kg: float,
    height_m: float,
    settings: BodySettings,
    breadths: dict[str, float] | None = None,
) -> Body:
    """The body of a person given by figures.

    Args:
        scales: Scale of each body of the skeleton along its axes [-].
        mass_kg: Mass [kg].
        height_m: Height [m]; 0 where unknown, then the segment lengths decide.
        settings: Settings of the skin.
        breadths: Breadths of the joints, where measured (see `joint_breadths`).

    Raises:
        InputError: The mass is unknown, or the file of the model cannot be used.
        ConfigError: A model needs a file and none is named.
        GeometryError: A mesh has no such leg.
    """
    if not mass_kg > 0.0:
        raise InputError(
            "the subject's mass is unknown",
            where="body stage",
            hint="set subject.mass_kg in the configuration",
        )
    target = skeleton_joints(skeleton_from_table(scaled_table(load_table(), scales, mass_kg)))
    lengths = {**fit.target_figures(target), **(breadths or {})}
    size = (mass_kg, height_m)
    own = _own_skin(target, height_m, settings) or _model(settings)

    def hang(length: float) -> Body:
        loose = own if isinstance(own, LooseSkin) else fitted_skin(own, target, lengths, size, length)
        return _hung(loose, target, length, size, scales, settings)

    *first, last = _lengths_tried(settings)
    return next((body for body in map(hang, first) if bends_whole(body)), None) or hang(last)


def _lengths_tried(settings: BodySettings) -> tuple[float, ...]:
    """Diffusion lengths of the weights to try [mm], until the knees bend whole."""
    if settings.weight_smoothing_mm is not None:
        return (settings.weight_smoothing_mm,)
    return SMOOTHING_MM[:1] if settings.skinning == "linear" else SMOOTHING_MM


def fitted_skin(
    model: BodyModel,
    target: dict[str, Float[Array, " 3"]],
    lengths: dict[str, float],
    size: tuple[float, float],
    smoothing_mm: float,
) -> LooseSkin:
    """The skin of a model with shape coefficients, with the person's figures.

    Args:
        model: The body model.
        target: Joint centres of the skeleton in the neutral pose [m].
        lengths: Figures of `hilbrace.body.fit.measure` that are known.
        size: Mass [kg] and height [m] of the person; height 0 where unknown.
        smoothing_mm: Diffusion length of the weights [mm]; height and volume change a little with it.
    """
    mass, height = size
    raw = model.bone_weights()
    weights = smoothed_weights(model.template, model.triangles, raw, smoothing_mm / MM_PER_M)
    shape = _fitted(model, weights, target, lengths, (mass / fit.DENSITY, height))
    return LooseSkin(
        model=model.name,
        shape=shape,
        vertices=model.vertices(shape),
        triangles=np.array(model.triangles),
        raw_weights=raw,
        smoothed_on=model.template,
        joints=model.joints(shape),
        whole=True,
    )


def _hung(
    loose: LooseSkin,
    target: dict[str, Float[Array, " 3"]],
    smoothing_mm: float,
    size: tuple[float, float],
    scales: Scales,
    settings: BodySettings,
) -> Body:
    """The body with its skin on the skeleton, its weights smoothed over a length."""
    mass, height = size
    weights = smoothed_weights(loose.smoothed_on, loose.triangles, loose.raw_weights, smoothing_mm / MM_PER_M)
    vertices = place(loose.joints, target).apply(loose.vertices, weights)
    own = float(np.ptp(vertices[:, 1])) if loose.whole else height
    if own == 0.0:
        own = height_of_leg(float(np.linalg.norm(target["hip_r"] - target["ankle_r"])))
    return Body(
        model=loose.model,
        mass_kg=mass,
        height_m=height if height > 0.0 else own,
        scaled_bodies=tuple(scales),
        segment_scales=np.stack([np.asarray(scale, dtype=float) for scale in scales.values()]),
        shape=loose.shape,
        vertices=vertices,
        triangles=loose.triangles,
        bones=BONES,
        bone_weights=weights,
        joint_names=JOINTS,
        joint_centres=np.stack([target[name] for name in JOINTS]),
        fit_error_mm=joint_distances(loose.joints, target) * MM_PER_M,
        height_error_mm=(own - height) * MM_PER_M if height > 0.0 else 0.0,
        skinning=settings.skinning,
        weight_smoothing_mm=smoothing_mm,
    )


def _own_skin(
    target: dict[str, Float[Array, " 3"]], height_m: float, settings: BodySettings
) -> LooseSkin | None:
    """The person's own skin, where a mesh or a fitted scan gives it."""
    if settings.model == "mesh":
        return mesh_skin(target, height_m, settings)
    return scanned_skin(settings) if settings.model == "scan" else None


def _model(settings: BodySettings) -> BodyModel:
    return load_skel(settings.model_file, settings.gender) if settings.model == "skel" else load_anny_lite()


def _fitted(
    model: BodyModel,
    weights: Float[Array, "vertex bone"],
    target: dict[str, Float[Array, " 3"]],
    lengths: dict[str, float],
    size: tuple[float, float],
) -> Float[Array, " coefficient"]:
    """Shape whose neutral skin has the volume [m^3] and height [m] (where not 0) of ``size``."""
    volume, height = size
    asked_volume, asked_height = size
    shape = np.zeros(len(model.coefficient_names))
    for _ in range(ROUNDS):
        whole = {"volume": float(np.log(asked_volume))} | ({"height": asked_height} if height > 0.0 else {})
        shape = fit.fit_shape(model, lengths | whole)
        vertices = place(model.joints(shape), target).apply(model.vertices(shape), weights)
        asked_volume *= volume / fit.enclosed_volume(vertices, model.triangles)[0]
        asked_height += height - float(np.ptp(vertices[:, 1]))
    return shape
