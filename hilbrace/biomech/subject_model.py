"""The model that follows a motion: the built-in one scaled to the subject, or the user's own."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hilbrace.biomech.calibration import calibrate
from hilbrace.biomech.engine import Engine
from hilbrace.biomech.kinematics import NEEDED_COORDINATES, own_markers
from hilbrace.biomech.markers import PlacedMarkers, segments_lacking
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.body.body import Body
from hilbrace.config import BiomechSettings
from hilbrace.errors import InputError
from hilbrace.motion.marker_maps import MarkerMap, segment_of
from hilbrace.motion.trial import Trial
from hilbrace.skeleton.kinematics import Skeleton, skeleton_from_table
from hilbrace.skeleton.scaling import scaled_table
from hilbrace.skeleton.table import load_source_table, load_table

Array = np.ndarray

MASS_MISMATCH = 0.15
"""Difference between a user's model and the subject above which its mass is scaled [-]."""
LENGTH_MISMATCH = 0.10
"""Difference of thigh or shank above which a user's model counts as unscaled [-]."""
SAME_MASS = 1e-4
"""A model whose mass is this near to the published generic one's was never scaled [-]."""

_CHAIN = (("femur", "tibia"), ("tibia", "talus"))
_NEEDED_BODIES = tuple(f"{body}_{side}" for side in "rl" for body in ("tibia", "talus", "calcn", "toes"))
_NEEDED_ANGLES = tuple(f"{angle}_angle_{side}" for side in "rl" for angle in ("knee", "ankle"))


class SubjectModel(NamedTuple):
    """A model in the engine, ready to follow a motion.

    Attributes:
        figures: Its figures.
        markers: Markers on it.
        start: Pose to start from, up to place and heading [rad or m].
        notes: How it came about, one sentence each.
    """

    figures: ModelFigures
    markers: PlacedMarkers
    start: Float[Array, " coordinate"]
    notes: tuple[str, ...]


def subject_model(
    engine: Engine, trial: Trial, body: Body, marker_map: MarkerMap, settings: BiomechSettings
) -> SubjectModel:
    """Load the subject's model into the engine and put the markers on it.

    The built-in model is scaled by the body's factors and mass. A model of the user (``biomech.model``) keeps
    its size and its markers if it fits the subject; only its knees gain adduction and rotation. A generic one
    is scaled: thighs, shanks and pelvis to the lengths between the subject's joint centres, other bodies by
    the body's factors, and its markers are placed as on the built-in model.

    Args:
        engine: A running engine.
        trial: The motion.
        body: The subject's segment scales and mass.
        marker_map: Meaning of the marker names.
        settings: Which model.

    Raises:
        InputError: The model lacks what the loads need, or markers do not suffice.
    """
    if settings.model is None:
        built = engine.call(
            "build_model", bodies=body.scaled_bodies, scales=body.segment_scales, mass_kg=body.mass_kg
        )
        figures = ModelFigures(**built)
        return SubjectModel(figures, *calibrate(engine, figures, trial, marker_map))
    path = str(settings.model)
    figures = ModelFigures(**engine.call("read_model", path=str(settings.model.resolve())))
    _check(figures, path)
    freed = [name for name in figures.locked if name in NEEDED_COORDINATES]
    said = [f"model '{figures.name}' locks {', '.join(freed)}: freed, since the markers show them"]
    said = said if freed else []
    scales = dict(zip(body.scaled_bodies, body.segment_scales, strict=True))
    subject = skeleton_from_table(scaled_table(load_table(), scales, body.mass_kg))
    ratios = _ratios(engine, figures, subject)
    generic = abs(figures.mass_kg / _generic_mass() - 1.0) < SAME_MASS
    misfit = max(abs(ratio - 1.0) for bone, ratio in ratios.items() if bone != "pelvis")
    if generic or misfit > LENGTH_MISMATCH:
        factors = _factors(figures, scales, ratios)
        figures, note = _scaled(engine, figures, factors, body.mass_kg)
        return _with_markers_placed(engine, figures, trial, marker_map, subject, (*said, note))
    if abs(figures.mass_kg / body.mass_kg - 1.0) > MASS_MISMATCH:
        figures, note = _scaled(engine, figures, {}, body.mass_kg)
        said.append(note)
    said.append(
        f"model '{figures.name}' of {figures.mass_kg:.1f} kg was used with its own size; "
        "its knees gained adduction and rotation"
    )
    markers, start = own_markers(figures)
    lacking = segments_lacking(markers.of(trial.marker_names))
    if lacking:
        said.append(f"its markers do not name those of the recording ({lacking[0]}), which were placed on it")
        return _with_markers_placed(engine, figures, trial, marker_map, subject, tuple(said))
    return SubjectModel(figures, markers, start, (*said, "the markers are where the model has them"))


def _check(figures: ModelFigures, path: str) -> None:
    """A user's model must have the joints that we read."""
    lacking = [name for name in _NEEDED_ANGLES if name not in figures.coordinates]
    lacking += [name for name in _NEEDED_BODIES if name not in figures.bodies]
    if lacking:
        raise InputError(
            f"the model has no {', '.join(dict.fromkeys(lacking))}",
            where=path,
            hint="use a model of the Rajagopal family, or leave biomech.model out",
        )


def _ratios(engine: Engine, figures: ModelFigures, subject: Skeleton) -> dict[str, float]:
    """Length of the subject's thighs, shanks and pelvis over the model's, by body, in the neutral pose."""
    zero = np.zeros((1, len(figures.coordinates)))
    frames = engine.call("poses", coordinates=zero)
    own: dict[str, Array] = {}
    for body, centre in figures.joint_centres.items():
        row = figures.bodies.index(body)
        own[body] = frames["origins"][0, row] + frames["rotations"][0, row] @ centre
    pose = subject.forward({})
    wanted = {body: pose[body].origin[0] for body in subject.bodies}

    def ratio(first: str, second: str) -> float:
        length = np.linalg.norm(wanted[first] - wanted[second])
        return float(length / np.linalg.norm(own[first] - own[second]))

    ratios = {f"{a}_{s}": ratio(f"{a}_{s}", f"{b}_{s}") for a, b in _CHAIN for s in "rl"}
    return ratios | {"pelvis": ratio("femur_r", "femur_l")}


def _factors(
    figures: ModelFigures, scales: dict[str, Float[Array, " 3"]], ratios: dict[str, float]
) -> dict[str, Float[Array, " 3"]]:
    """Factors of every body: by length where the model has it, else those of the built-in model's body."""
    factors: dict[str, Array] = {}
    for body in figures.bodies:
        measured = ratios.get(body.replace("patella", "femur"))
        other = np.asarray(scales.get(body, np.ones(3)), dtype=float)
        factors[body] = other if measured is None else np.full(3, measured)
    return factors


def _scaled(
    engine: Engine, figures: ModelFigures, factors: dict[str, Float[Array, " 3"]], mass_kg: float
) -> tuple[ModelFigures, str]:
    changed = engine.call(
        "scale_model",
        bodies=tuple(factors),
        scales=np.array(list(factors.values())).reshape(-1, 3),
        mass_kg=mass_kg,
    )
    lengths = ", ".join(
        f"{name} {factors[body][0]:.3f}"
        for name, body in (("pelvis", "pelvis"), ("thigh", "femur_r"), ("shank", "tibia_r"))
        if body in factors
    )
    size = f"by {lengths}" if lengths else "in mass alone"
    return ModelFigures(**changed), (
        f"model '{figures.name}' of {figures.mass_kg:.1f} kg is not the subject's: "
        f"it was scaled to {mass_kg:.1f} kg, {size}"
    )


def _with_markers_placed(
    engine: Engine,
    figures: ModelFigures,
    trial: Trial,
    marker_map: MarkerMap,
    subject: Skeleton,
    said: tuple[str, ...],
) -> SubjectModel:
    """Place the recorded markers on a user's model as on the built-in one.

    Where the model has no marker of a landmark, that of the built-in model counts, whose bodies have the
    same frames in all models of the family.
    """
    carriers = segment_of(marker_map)
    absent = {name for name, body in carriers.items() if body not in figures.bodies}
    left = replace(
        marker_map,
        landmarks={n: mark for n, mark in marker_map.landmarks.items() if n not in absent},
        clusters={n: body for n, body in marker_map.clusters.items() if n not in absent},
        ignored=(*marker_map.ignored, *(name.replace("[", "[[]") for name in absent)),
    )
    bodies, locations = {}, {}
    for name, mark in left.landmarks.items():
        own = next((label for label in (name, mark) if label in figures.marker_bodies), None)
        bodies[mark] = subject.marker_body[mark] if own is None else figures.marker_bodies[own]
        locations[mark] = subject.marker_location[mark] if own is None else figures.marker_locations[own]
    with_landmarks = replace(figures, marker_bodies=bodies, marker_locations=locations)
    markers, start, notes = calibrate(engine, with_landmarks, trial, left)
    if absent:
        said = (*said, f"the model has no bodies for the markers {', '.join(sorted(absent))}: not used")
    return SubjectModel(figures, markers, start, (*said, *notes))


def _generic_mass() -> float:
    return sum(body["mass"] for body in load_source_table()["bodies"].values())
