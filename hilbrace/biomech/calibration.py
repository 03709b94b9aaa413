"""Where every marker sits on the scaled model: from a standing trial, or from the motion itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from hilbrace.biomech.engine import Engine
from hilbrace.biomech.kinematics import KNEE_FRONTAL, facing, fixed_coordinates, poses_of
from hilbrace.biomech.markers import (
    PlacedMarkers,
    check_segments,
    landmarks_on_model,
    weight_of,
    with_ankle_centres,
)
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import MarkerMap, match_markers
from hilbrace.motion.trial import Trial
from hilbrace.units import MM_PER_M

Array = np.ndarray

SAMPLE_FRAMES = 24
"""Frames of a motion in which markers are placed where nobody stands still."""
ROUNDS = 2
"""Turns of fitting poses to markers, then placing markers in the poses, without a standing trial.

The first turn sets the joints' zeros by the landmarks, the second makes clusters agree with them. More turns
let the zeros drift, since nothing holds them any longer: knees by 2 deg after 25 turns on recorded walks.
"""
FLAT_WITHIN = np.radians(20.0)
"""Tilt of a foot beyond which a standing subject is not taken to stand flat [rad]."""
LEVELLING = 3
"""Turns of the ankle towards a level foot; its axis is oblique."""
UPRIGHT_KNEES = np.radians(30.0)
"""Mean flexion of both knees up to which a person in motion counts as upright [rad]."""
UPRIGHT_SHARE = 0.25
"""Greatest share of the sampled frames that count as upright, those with the straightest knees."""
PELVIS_SPREAD = np.radians(5.0)
"""Standard deviation of an upright person's pelvis from level, in the model's sense of level [rad].

The line from the anterior to the posterior iliac spines tells it no better: in pelves set up alike it lies
at 0 to 23 deg, with a standard deviation of 5 deg (Preece et al., "Variation in pelvic morphology may prevent
the identification of anterior pelvic tilt", J. Man. Manip. Ther. 16(2), 113-117, 2008).
"""
LEAST_SHARE = 0.2
"""Share of the sampled frames that must show a marker for it to be placed."""


def calibrate(
    engine: Engine, figures: ModelFigures, trial: Trial, marker_map: MarkerMap
) -> tuple[PlacedMarkers, Float[Array, " coordinate"], tuple[str, ...]]:
    """Put every marker where it sits on the scaled model.

    The poses come from the landmarks at the model's places; then each marker, landmark or cluster, moves to
    where it was measured in them (as OpenSim's marker placer does), so that what is left of a landmark's
    misfit does not disturb the motion. A standing knee is neutral in adduction and rotation by definition:
    what its landmarks say otherwise is the shape of the bones. Standing feet are flat.

    Without a standing trial the same is done in frames spread over the motion, in turns (`ROUNDS`): the
    median of a marker's places over the frames counts, and the knee is neutral on average. Bony landmarks
    decide where the joints' zeros are, so that angles may be off by some degrees as a whole; for the pelvis
    the posture of upright frames counts as well (`_with_level_pelvis`).

    Args:
        engine: Engine that holds the scaled model.
        figures: Figures of that model.
        trial: Recording.
        marker_map: Meaning of the marker names.

    Returns:
        Markers on the model, a pose to start from [rad or m], and notes.

    Raises:
        InputError: Too few landmarks, or the map does not fit the model.
    """
    names = (*trial.static_marker_names, *trial.marker_names)
    marker_map = match_markers(marker_map, names, f"'{trial.name}' and its standing trial")
    if trial.static_marker_names:
        return _standing(engine, figures, trial, marker_map)
    return _moving(engine, figures, trial, marker_map)


def _standing(
    engine: Engine, figures: ModelFigures, trial: Trial, marker_map: MarkerMap
) -> tuple[PlacedMarkers, Float[Array, " coordinate"], tuple[str, ...]]:
    place = dict(zip(trial.static_marker_names, trial.static_markers, strict=True))
    place = {name: point for name, point in place.items() if np.isfinite(point).all()}
    landmarks = landmarks_on_model(marker_map, figures).of(place)
    check_segments(landmarks, place, f"standing trial of '{trial.name}'", standing=True)
    measured = np.array([place[name] for name in landmarks.names])[None]
    landmarks, measured = with_ankle_centres(landmarks, measured, marker_map.landmarks)
    poses, errors = _fit(engine, figures, landmarks, measured, figures.defaults)
    poses, levelled = _with_flat_feet(engine, figures, poses)
    names = [name for name in marker_map.known() if name in place]
    points = np.array([place[name] for name in names])[None]
    placed = _place(engine, figures, poses, marker_map, names, points)
    misfit = _misfit_mm(errors, landmarks)
    return (
        placed,
        poses[0],
        (f"standing pose: bony landmarks within {misfit:.1f} mm RMS of the scaled model", *levelled),
    )


def _with_flat_feet(
    engine: Engine, figures: ModelFigures, poses: Float[Array, "frame coordinate"]
) -> tuple[Float[Array, "frame coordinate"], list[str]]:
    """Turn the ankles until the feet are level, as the feet of a standing subject are.

    A marker on the heel sits higher or lower on every shoe, and tilts the foot against the shank by its
    height over the length of the foot. The floor does not. In the model's neutral pose the sole is level and
    the calcaneus's anterior axis with it.

    Returns:
        The poses, and a note about feet that are too steep to stand flat, which are left alone.
    """
    levelled, notes = poses.copy(), []
    for side in "rl":
        name = f"ankle_angle_{side}"
        if name not in figures.coordinates:
            continue
        column = figures.columns([name])[0]
        first = _pitch(engine, figures, levelled, side)
        if np.abs(first).max() > FLAT_WITHIN:
            notes.append(
                f"standing pose: the {'right' if side == 'r' else 'left'} foot is tilted by "
                f"{np.degrees(first[0]):.0f} deg and was not taken for flat"
            )
            continue
        for _ in range(LEVELLING):
            levelled[:, column] -= _pitch(engine, figures, levelled, side)
    return levelled, notes


def _pitch(
    engine: Engine, figures: ModelFigures, poses: Float[Array, "frame coordinate"], side: str
) -> Float[Array, " frame"]:
    """Angle of a foot's long axis over the level [rad]."""
    rotations, _ = poses_of(engine, figures, poses, [f"calcn_{side}"])
    return np.arcsin(np.clip(rotations[:, 0, 1, 0], -1.0, 1.0))


def _moving(
    engine: Engine, figures: ModelFigures, trial: Trial, marker_map: MarkerMap
) -> tuple[PlacedMarkers, Float[Array, " coordinate"], tuple[str, ...]]:
    surveyed = trial.markers_to_measure()
    frames = _sampled(surveyed)
    paths = {name: surveyed[frames, k] for k, name in enumerate(trial.marker_names)}
    shown = {n: np.isfinite(path).all(axis=1).mean() >= LEAST_SHARE for n, path in paths.items()}
    names = [name for name in marker_map.known() if shown.get(name, False)]
    landmarks = landmarks_on_model(marker_map, figures).of(names)
    check_segments(landmarks, names, f"motion '{trial.name}'", standing=True)
    measured = np.stack([paths[name] for name in landmarks.names], axis=1)
    markers, targets = with_ankle_centres(landmarks, measured, marker_map.landmarks)
    points = np.stack([paths[name] for name in names], axis=1)
    start = figures.defaults
    poses, errors = _fit(engine, figures, markers, targets, start)
    misfit = _misfit_mm(errors, markers)
    markers = _with_level_pelvis(engine, figures, markers, targets, poses, misfit / MM_PER_M, marker_map)
    for _ in range(ROUNDS):
        poses, _ = _fit(engine, figures, markers, targets, start)
        markers = _place(engine, figures, poses, marker_map, names, points)
        targets, start = points, poses[0]
    note = (
        f"no standing trial: markers were placed in {len(frames)} frames of the motion, the knees neutral on "
        f"average; bony landmarks within {misfit:.1f} mm RMS of the scaled model; joint angles may be off by "
        "some degrees as a whole, and muscle and contact forces with them: a standing trial (motion.static) "
        "or a model of the subject (biomech.model) mends that"
    )
    return markers, start, (note,)


def _with_level_pelvis(
    engine: Engine,
    figures: ModelFigures,
    landmarks: PlacedMarkers,
    measured: Float[Array, "frame marker 3"],
    poses: Float[Array, "frame coordinate"],
    misfit_m: float,
    marker_map: MarkerMap,
) -> PlacedMarkers:
    """Place the pelvis markers where upright frames, with the pelvis expected level, put them.

    The iliac spines alone would tilt the pelvis by up to ten degrees, and carry the hips forward or back by
    centimetres. Posture knows as much: an upright person's pelvis is near the model's neutral one, within
    `PELVIS_SPREAD`. Both count by their spreads: the tilt is held with the stiffness (misfit / spread)^2, so
    that landmarks that fit the model are believed. A motion without upright frames is left alone.

    Args:
        engine: Engine that holds the scaled model.
        figures: Figures of that model.
        landmarks: Landmarks at the model's places.
        measured: Their measured places [m].
        poses: Poses that fit them.
        misfit_m: RMS distance of the landmarks from the model there [m].
        marker_map: Meaning of the marker names.

    Returns:
        The landmarks, those of the pelvis where they were measured and at full weight.
    """
    if "pelvis_tilt" not in figures.coordinates:
        return landmarks
    knees = poses[:, figures.columns(["knee_angle_r", "knee_angle_l"])].mean(axis=1)
    upright = knees <= min(UPRIGHT_KNEES, float(np.quantile(knees, UPRIGHT_SHARE)))
    if not upright.any():
        return landmarks
    level = poses[upright][0]
    level[figures.columns(["pelvis_tilt"])] = 0.0
    held = {"pelvis_tilt": (misfit_m / PELVIS_SPREAD) ** 2}
    poses, _ = _fit(engine, figures, landmarks, measured[upright], level, held)
    on_pelvis = [k for k, body in enumerate(landmarks.bodies) if body == "pelvis"]
    names = [landmarks.names[k] for k in on_pelvis]
    placed = _place(engine, figures, poses, marker_map, names, measured[upright][:, on_pelvis])
    locations, weights = landmarks.locations.copy(), landmarks.weights.copy()
    locations[on_pelvis], weights[on_pelvis] = placed.locations, placed.weights
    return replace(landmarks, locations=locations, weights=weights)


def _sampled(surveyed: Float[Array, "frame marker 3"]) -> Int[Array, " sample"]:
    """Frames spread evenly over those that show the most markers."""
    seen = np.isfinite(surveyed).all(axis=2).sum(axis=1)
    best = np.flatnonzero(seen >= np.quantile(seen, 0.5))
    return best[np.unique(np.linspace(0, len(best) - 1, SAMPLE_FRAMES).round().astype(int))]


def _fit(
    engine: Engine,
    figures: ModelFigures,
    markers: PlacedMarkers,
    measured: Float[Array, "frame marker 3"],
    start: Float[Array, " coordinate"],
    held: dict[str, float] | None = None,
) -> tuple[Float[Array, "frame coordinate"], Float[Array, "frame marker"]]:
    first = np.flatnonzero(np.isfinite(measured[0]).all(axis=1))
    if len(first) < 3:
        raise InputError(
            "a frame shows fewer than three bony landmarks",
            where="markers on the model",
            hint="fill the gaps of the landmarks, or record a standing trial",
        )
    visible = markers.of(markers.names[k] for k in first)
    fitted = engine.call(
        "inverse_kinematics",
        bodies=markers.bodies,
        locations=markers.locations,
        weights=markers.weights,
        measured=measured,
        start=facing(engine, figures, visible, measured[0, first], start),
        fixed=(*fixed_coordinates(figures, markers), *KNEE_FRONTAL),
        held=held or {},
    )
    return fitted["coordinates"], fitted["errors"]


def _place(
    engine: Engine,
    figures: ModelFigures,
    poses: Float[Array, "frame coordinate"],
    marker_map: MarkerMap,
    names: Sequence[str],
    points: Float[Array, "frame marker 3"],
) -> PlacedMarkers:
    """Markers at the median of their places in the bodies that carry them."""
    carriers = [
        figures.marker_bodies[marker_map.landmarks[name]]
        if name in marker_map.landmarks
        else marker_map.clusters[name]
        for name in names
    ]
    rotations, origins = poses_of(engine, figures, poses, carriers)
    places = np.einsum("fmji,fmj->fmi", rotations, points - origins)
    weights = np.array([weight_of(body) for body in carriers])
    return PlacedMarkers(tuple(names), tuple(carriers), np.nanmedian(places, axis=0), weights)


def _misfit_mm(errors: Float[Array, "frame marker"], landmarks: PlacedMarkers) -> float:
    return 1e3 * float(np.sqrt(np.nanmean(errors[:, landmarks.weights == 1] ** 2)))
