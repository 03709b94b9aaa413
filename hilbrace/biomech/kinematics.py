"""From markers to joint angles: follow a motion with a model that carries its markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from hilbrace.biomech.engine import Engine, Report
from hilbrace.biomech.marker_report import load_bearing, marker_report, report_notes
from hilbrace.biomech.markers import (
    PlacedMarkers,
    check_segments,
    markers_of_model,
)
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.errors import InputError
from hilbrace.motion.filters import gap_free_runs
from hilbrace.motion.trial import Trial

Array = np.ndarray

KNEE_FRONTAL = ("knee_adduction_r", "knee_rotation_r", "knee_adduction_l", "knee_rotation_l")
"""Coordinates that skin movement disturbs most and that `BiomechSettings.knee_regularisation` holds."""
_LEG = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "ankle_angle")
LEGS = (
    *("pelvis_tilt", "pelvis_list", "pelvis_rotation"),
    *(f"{name}_{side}" for side in "rl" for name in _LEG),
)
"""Coordinates that the loads of knees and ankles stand on."""
NEEDED_COORDINATES = frozenset((*LEGS, *KNEE_FRONTAL, "pelvis_tx", "pelvis_ty", "pelvis_tz"))
"""Coordinates that the fit moves even where a user's model locks them."""
SUPPORT_M2 = 1e-3
"""Stiffness by markers [m^2] below which a coordinate counts as unseen: 0.1 rad move them 3 mm in all."""
LONGEST_GAP_S = 0.1
"""Longest stretch over which an unseen leg is interpolated [s]."""
SKIN_M = 0.005
"""RMS residual of the legs' markers below which they do not behave like markers on skin [m].

Skin moves by 10 to 30 mm on thighs and by up to 15 mm on shanks (Leardini, Chiari, Della Croce & Cappozzo,
"Human movement analysis using stereophotogrammetry, part 3", Gait Posture 21, 2005); recorded walks, squats
and landings leave 5 to 13 mm.
"""
PROBED_FRAMES = 16
"""About as many frames tell how well the markers fit when nothing is held."""
_LEG_BODIES = ("femur", "tibia", "talus", "calcn", "toes")
FOOT_MARKERS = 3
"""Markers on a foot that make its inversion visible."""


@dataclass(frozen=True)
class Kinematics:
    """Coordinates over the frames of a motion, as fitted.

    Attributes:
        coordinates: Values [rad or m], in the model's order.
        marker_names: Markers tracked.
        marker_bodies: Body that carries each.
        marker_error: Distance of each from the model's [m]; NaN in gaps.
        notes: What was left out or bridged, one sentence each.
    """

    coordinates: Float[Array, "frame coordinate"]
    marker_names: tuple[str, ...]
    marker_bodies: tuple[str, ...]
    marker_error: Float[Array, "frame marker"]
    notes: tuple[str, ...]


def follow(
    engine: Engine,
    figures: ModelFigures,
    trial: Trial,
    markers: PlacedMarkers,
    start: Float[Array, " coordinate"],
    knee_hold: float,
    progress: Report,
) -> Kinematics:
    """Fit the model to every frame of the motion.

    Args:
        engine: Engine that holds the model.
        figures: Figures of that model.
        trial: The motion.
        markers: Markers on the model.
        start: Pose near the first frame's, up to place and heading [rad or m].
        knee_hold: Stiffness that holds knee adduction and rotation near zero against the motion of skin, and
            so the inversion of a foot with fewer than `FOOT_MARKERS` markers [m^2]. It fades where the
            markers fit better than skin ever lets them (`SKIN_M`).
        progress: Called with (done, total) frames.

    Raises:
        InputError: Too few markers, or a leg unseen for longer than `LONGEST_GAP_S`.
        SolverError: The fit does not converge.
    """
    seen = np.asarray(np.isfinite(trial.markers).all(axis=2))
    present = [name for k, name in enumerate(trial.marker_names) if seen[:, k].any()]
    tracked = markers.of(present)
    check_segments(tracked, present, f"motion '{trial.name}'")
    measured = trial.markers[:, [trial.marker_names.index(name) for name in tracked.names]]
    first = np.flatnonzero(np.isfinite(measured[0]).all(axis=1))
    if len(first) < 3:
        raise InputError(
            "the first frame shows fewer than three markers",
            where=f"motion '{trial.name}', frame 1",
            hint="start later with motion.window",
        )
    visible = tracked.of(tracked.names[k] for k in first)
    fixed = fixed_coordinates(figures, tracked)
    softened = (*KNEE_FRONTAL, *(name for name in fixed if name.startswith("subtalar_angle")))
    start = facing(engine, figures, visible, measured[0, first], start)
    every = max(1, len(measured) // PROBED_FRAMES)
    probe = _fit(engine, tracked, measured[::every], start, fixed, {})
    share = _share_of_skin(probe["errors"], tracked) if trial.static_marker_names else 1.0
    held = dict.fromkeys(softened, knee_hold * share)
    free = tuple(name for name in fixed if name not in held)
    fitted = _fit(engine, tracked, measured, start, free, held, progress)
    coordinates, bridged = _bridge(fitted["coordinates"], fitted["support"], figures, trial)
    notes = [
        *bridged,
        *_faded(share, knee_hold),
        *_listed(
            "recorded markers without a place on the model, not used", set(present) - set(markers.names)
        ),
        *_listed("markers of the model that the motion does not show", set(markers.names) - set(present)),
    ]
    errors = fitted["errors"]
    notes += report_notes(
        marker_report(tracked.names, errors), load_bearing(tracked.names, tracked.bodies, errors), trial.time
    )
    return Kinematics(coordinates, tracked.names, tracked.bodies, errors, tuple(notes))


def _fit(
    engine: Engine,
    markers: PlacedMarkers,
    measured: Float[Array, "frame marker 3"],
    start: Float[Array, " coordinate"],
    fixed: tuple[str, ...],
    held: dict[str, float],
    progress: Report | None = None,
) -> dict[str, Any]:
    return engine.call(
        "inverse_kinematics",
        progress=progress,
        bodies=markers.bodies,
        locations=markers.locations,
        weights=markers.weights,
        measured=measured,
        start=start,
        fixed=fixed,
        held=held,
    )


def _share_of_skin(errors: Float[Array, "frame marker"], markers: PlacedMarkers) -> float:
    """How much of the hold applies, from the residuals of the legs' markers when nothing is held [-].

    A hold of stiffness h stands for a normal prior of spread tau on the coordinate and an error sigma of the
    markers, h = (sigma / tau)^2. Markers on skin leave at least `SKIN_M`; what they hide in the rigid part
    of their motion cannot be seen in residuals, so that larger ones do not raise the hold. Markers that fit
    much better sit on no skin (pins, phantoms, simulations), and are believed. Markers that were placed in
    the motion itself fit better than they should, and prove nothing.
    """
    legs = [k for k, body in enumerate(markers.bodies) if body.startswith(_LEG_BODIES)]
    known = errors[:, legs][np.isfinite(errors[:, legs])]
    if not len(known):
        return 1.0
    return float(min(1.0, (known**2).mean() / SKIN_M**2))


def _faded(share: float, knee_hold: float) -> list[str]:
    if share == 1.0 or knee_hold == 0.0:
        return []
    return [
        f"the legs' markers fit better than markers on skin: knee adduction and rotation are held with "
        f"{100 * share:.2g} % of biomech.knee_regularisation"
    ]


def own_markers(figures: ModelFigures) -> tuple[PlacedMarkers, Float[Array, " coordinate"]]:
    """Markers and pose that a user's model brings; nothing is scaled or moved."""
    return markers_of_model(figures), figures.defaults


def _listed(what: str, names: set[str]) -> list[str]:
    return [f"{what}: {', '.join(sorted(names))}"] if names else []


def fixed_coordinates(figures: ModelFigures, markers: PlacedMarkers) -> tuple[str, ...]:
    """Coordinates that stay: those the model locks, less those of a foot that carries enough markers.

    Inversion is free where a foot carries three markers; the toes' joint where the toes do themselves. Wrists
    stay locked, since nobody's markers on the forearm show them. What a user's model locks at hips, knees and
    ankles is free, too.
    """
    freed = set(NEEDED_COORDINATES)
    for side in "rl":
        foot = [body for body in markers.bodies if body in (f"calcn_{side}", f"toes_{side}")]
        if len(foot) >= FOOT_MARKERS:
            freed.add(f"subtalar_angle_{side}")
        if foot.count(f"toes_{side}") and foot.count(f"calcn_{side}") >= FOOT_MARKERS:
            freed.add(f"mtp_angle_{side}")
    return tuple(name for name in figures.locked if name not in freed)


def facing(
    engine: Engine,
    figures: ModelFigures,
    markers: PlacedMarkers,
    measured: Float[Array, "marker 3"],
    pose: Float[Array, " coordinate"],
) -> Float[Array, " coordinate"]:
    """The pose, moved to the measured place and turned about the vertical to the measured heading."""
    root = ("pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
    if not set(root) <= set(figures.coordinates):
        return pose
    turned = pose.copy()
    columns = figures.columns(root)
    for _ in range(2):  # the second pass mends the place after the turn about the pelvis
        rotations, origins = poses_of(engine, figures, turned[None], markers.bodies)
        model = (origins + np.einsum("fmij,mj->fmi", rotations, markers.locations))[0]
        a, b = model - model.mean(axis=0), measured - measured.mean(axis=0)
        along = (a[:, 0] * b[:, 0] + a[:, 2] * b[:, 2]).sum()
        across = (a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]).sum()
        turned[columns[0]] += np.arctan2(across, along)
        turned[columns[1:]] += (measured - model).mean(axis=0)
    return turned


def poses_of(
    engine: Engine, figures: ModelFigures, poses: Float[Array, "frame coordinate"], bodies: Sequence[str]
) -> tuple[Float[Array, "frame marker 3 3"], Float[Array, "frame marker 3"]]:
    """Rotations to the ground and origins [m] of some bodies, which may repeat, in some poses."""
    frames = engine.call("poses", coordinates=poses)
    rows = figures.rows(bodies)
    return frames["rotations"][:, rows], frames["origins"][:, rows]


def _bridge(
    coordinates: Float[Array, "frame coordinate"],
    support: Float[Array, "frame coordinate"],
    figures: ModelFigures,
    trial: Trial,
) -> tuple[Float[Array, "frame coordinate"], list[str]]:
    """Interpolate the coordinates of legs over the frames in which the markers do not show them."""
    values, notes = coordinates.copy(), []
    for name in [name for name in LEGS if name in figures.coordinates]:
        column = figures.coordinates.index(name)
        hidden = support[:, column] < SUPPORT_M2
        if not hidden.any():
            continue
        _check_gaps(hidden, name, trial)
        shown = np.flatnonzero(~hidden)
        values[:, column] = np.interp(np.arange(len(values)), shown, coordinates[shown, column])
        notes.append(f"{name}: {hidden.sum()} frames without sufficient markers were interpolated")
    return values, notes


def _check_gaps(hidden: Bool[Array, " frame"], name: str, trial: Trial) -> None:
    for run in gap_free_runs(np.where(hidden, 0.0, np.nan)):
        first, last = trial.time[run.start], trial.time[run.stop - 1]
        if (
            (run.stop - run.start) / trial.rate_hz > LONGEST_GAP_S
            or run.start == 0
            or run.stop == len(hidden)
        ):
            raise InputError(
                f"too few markers to find {name} in frames {run.start + 1} to {run.stop}",
                where=f"motion '{trial.name}', {first:.3f} to {last:.3f} s",
                hint="fill the gaps of the markers about that joint, or leave these frames out "
                "with motion.window",
            )
