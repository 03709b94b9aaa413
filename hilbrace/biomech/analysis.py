"""The biomechanics stage: from a recorded motion to the net loads across knees and ankles.

Scale, calibrate and follow (`kinematics`), low-pass the coordinates, then Newton-Euler (`dynamics`). The
acting force is the net force of the proximal on the distal segment: muscles count as their pull on the
proximal bone, so that contact force less muscle forces is what the segments below need to move as they do
against the ground reaction (paper, Eq. 1). It needs no estimate of single muscles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hilbrace.biomech import dynamics
from hilbrace.biomech.calibration import calibrate
from hilbrace.biomech.dynamics import GroundReaction, Momenta
from hilbrace.biomech.engine import Engine, Report
from hilbrace.biomech.joint_loads import JOINTS, JointLoads, without_muscles
from hilbrace.biomech.kinematics import Kinematics, follow, own_markers
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.body.body import Body
from hilbrace.config import BiomechSettings, MotionSettings
from hilbrace.errors import InputError
from hilbrace.motion.filters import gap_free_runs, lowpass
from hilbrace.motion.marker_maps import MarkerMap
from hilbrace.motion.trial import Trial
from hilbrace.run.progress import silent
from hilbrace.units import GRAVITY

Array = np.ndarray

SIDE = {"r": "right", "l": "left"}
UNMEASURED_BW = 0.5
UNMEASURED_S = 0.15
"""A vertical pelvis residual above this [body weights] for this long [s] is a support without a plate."""
MASS_MISMATCH = 0.15
"""Difference between a user's model and the subject above which the model counts as unscaled [-]."""


class JointOfModel(NamedTuple):
    """Where a joint of `JOINTS` is found in a model.

    Attributes:
        distal: Body that carries the frame of the loads.
        below: Bodies below the joint, the distal one included.
        coordinates: Coordinates of flexion, adduction and rotation; the ankle has two, or one where the
            model's subtalar joint is stiff.
        movers: Body whose turn shows the axis of each coordinate.
        foot: Name of the foot below.
    """

    distal: str
    below: tuple[str, ...]
    coordinates: tuple[str, ...]
    movers: tuple[str, ...]
    foot: str


def joint_of_model(joint: str, inversion: bool = True) -> JointOfModel:
    """Names of the bodies and coordinates of ``"knee_r"``, ``"ankle_l"``, ...

    Args:
        joint: One of `JOINTS`.
        inversion: Whether the model's subtalar joint moves.
    """
    name, side = joint.split("_")
    tibia, talus, calcn, toes = (f"{body}_{side}" for body in ("tibia", "talus", "calcn", "toes"))
    if name == "knee":
        turns = tuple(f"knee_{motion}_{side}" for motion in ("angle", "adduction", "rotation"))
        return JointOfModel(tibia, (tibia, talus, calcn, toes), turns, (tibia,) * 3, SIDE[side])
    turns, movers = (f"ankle_angle_{side}", f"subtalar_angle_{side}"), (talus, calcn)
    count = 2 if inversion else 1
    return JointOfModel(talus, (talus, calcn, toes), turns[:count], movers[:count], SIDE[side])


def joints_of_model(figures: ModelFigures) -> tuple[JointOfModel, ...]:
    """Where a model has each of `JOINTS`."""
    return tuple(
        joint_of_model(joint, f"subtalar_angle_{joint[-1]}" in figures.coordinates) for joint in JOINTS
    )


def compute_joint_loads(
    trial: Trial,
    body: Body,
    marker_map: MarkerMap,
    motion: MotionSettings,
    biomech: BiomechSettings,
    progress: Report = silent,
) -> JointLoads:
    """Angles and net loads of knees and ankles, per frame.

    The built-in model is scaled by the body's factors and mass. A model of the user (``biomech.model``) is
    used as it is, with its own markers, which the recording must name alike; only its knees gain adduction
    and rotation. It must be scaled to the subject.

    Args:
        trial: The motion, its forces filtered.
        body: The subject's segment scales and mass.
        marker_map: Meaning of the marker names; not used with a model of the user.
        motion: Cut-off frequency.
        biomech: Model and regularisation of the knees.
        progress: Called with (done, total) frames of the fit.

    Raises:
        InputError: Markers do not suffice, or the model does not fit the subject.
        SolverError: The fit or the OpenSim process fails.
    """
    hold = biomech.knee_regularisation
    with Engine() as engine:
        if biomech.model is None:
            figures = ModelFigures(
                **engine.call(
                    "build_model",
                    bodies=body.scaled_bodies,
                    scales=body.segment_scales,
                    mass_kg=body.mass_kg,
                )
            )
            markers, start, said = calibrate(engine, figures, trial, marker_map)
        else:
            figures = ModelFigures(**engine.call("read_model", path=str(biomech.model.resolve())))
            said = _check_own_model(figures, body.mass_kg, str(biomech.model))
            markers, start = own_markers(figures)
        fitted = follow(engine, figures, trial, markers, start, hold, progress)
        smooth = lowpass(fitted.coordinates, trial.rate_hz, motion.cutoff_hz)
        poses = engine.call("poses", coordinates=smooth)
        joints = joints_of_model(figures)
        moving = tuple(name for joint in joints for name in joint.coordinates)
        watched = tuple(dict.fromkeys(name for joint in joints for name in joint.below))
        partial = engine.call("partial_velocities", coordinates=smooth, moving=moving, bodies=watched)
    model = _Moved(figures, poses["rotations"], poses["origins"], moving, watched, partial)
    return _loads(trial, model, smooth, fitted, said, motion.cutoff_hz, biomech.convention)


class _Moved(NamedTuple):
    """A model over the frames of a motion: poses of all bodies, partial velocities of some.

    ``partial[frame, body, 0 | 1, :, coordinate]`` is the angular velocity and the velocity of the frame's
    origin of ``watched[body]`` per unit speed of ``moving[coordinate]``.
    """

    figures: ModelFigures
    rotations: Float[Array, "frame body 3 3"]
    origins: Float[Array, "frame body 3"]
    moving: tuple[str, ...]
    watched: tuple[str, ...]
    partial: Float[Array, "frame watched 2 3 moving"]

    def rotation(self, body: str) -> Float[Array, "frame 3 3"]:
        """Rotation of a body, its frame to ground."""
        return self.rotations[:, self.figures.bodies.index(body)]

    def joint_centre(self, body: str) -> Float[Array, "frame 3"]:
        """Centre of the joint that carries a body, in the ground [m]."""
        origin = self.origins[:, self.figures.bodies.index(body)]
        return origin + self.rotation(body) @ self.figures.joint_centres[body]


def _check_own_model(figures: ModelFigures, mass_kg: float, path: str) -> tuple[str, ...]:
    """A user's model must have the joints that we read, and the subject's size."""
    joints = joints_of_model(figures)
    lacking = [n for joint in joints for n in joint.coordinates if n not in figures.coordinates]
    lacking += [n for joint in joints for n in joint.below if n not in figures.bodies]
    if lacking:
        raise InputError(
            f"the model has no {', '.join(dict.fromkeys(lacking))}",
            where=path,
            hint="use a model of the Rajagopal family, or leave biomech.model out",
        )
    mismatch = figures.mass_kg / mass_kg - 1.0
    if abs(mismatch) > MASS_MISMATCH:
        raise InputError(
            f"the model weighs {figures.mass_kg:.1f} kg, the subject {mass_kg:.1f} kg: it is not scaled",
            where=path,
            hint="scale it to the subject in OpenSim, or leave biomech.model out to have ours scaled",
        )
    return (
        f"model '{figures.name}' of {figures.mass_kg:.1f} kg was used with its own size and markers; "
        "its knees gained adduction and rotation",
    )


def _loads(
    trial: Trial,
    model: _Moved,
    coordinates: Float[Array, "frame coordinate"],
    fitted: Kinematics,
    said: tuple[str, ...],
    cutoff_hz: float,
    convention: str,
) -> JointLoads:
    figures = model.figures
    segments = dynamics.momenta(
        model.rotations, model.origins, figures.masses, figures.centres, figures.inertias, trial.rate_hz
    )
    residual = segments.force.sum(axis=1) - trial.ground_force.sum(axis=1)
    shape = (len(trial.time), len(JOINTS), 3)
    angles, force, moment = np.zeros(shape), np.empty(shape), np.empty(shape)
    axes, inertia, rotation = np.empty((*shape, 3)), np.empty((*shape, 3)), np.empty((*shape, 3))
    jacobian = np.empty((*shape[:2], 6, 3))
    for k, joint in enumerate(joints_of_model(figures)):
        to_distal = np.swapaxes(model.rotation(joint.distal), -1, -2)
        wrench = dynamics.net_load(
            segments,
            figures.rows(joint.below),
            model.joint_centre(joint.distal),
            [_ground_reaction(trial, joint.foot)],
        )
        force[:, k] = np.einsum("fij,fj->fi", to_distal, wrench.force)
        moment[:, k] = np.einsum("fij,fj->fi", to_distal, wrench.moment)
        angles[:, k, : len(joint.coordinates)] = coordinates[:, figures.columns(joint.coordinates)]
        rotation[:, k] = model.rotation(joint.distal)
        about = _about_joint(model, joint, segments)
        axes[:, k] = np.einsum("fij,fkj->fki", to_distal, about.axes)
        inertia[:, k] = about.inertia
        jacobian[:, k] = np.concatenate([to_distal @ about.slip, to_distal @ about.turn], axis=1)
    return JointLoads(
        time=trial.time,
        body_mass_kg=trial.mass_kg,
        coordinate_names=figures.coordinates,
        coordinates=coordinates,
        muscles=figures.muscles,
        joints=JOINTS,
        angles=angles,
        distal_rotation=rotation,
        joint_axes=axes,
        acting_force=force,
        acting_moment=moment,
        convention=convention,
        inertia=inertia,
        distal_jacobian=jacobian,
        marker_names=fitted.marker_names,
        marker_error=fitted.marker_error,
        cutoff_hz=cutoff_hz,
        pelvis_residual_force=residual,
        **without_muscles(len(trial.time), len(JOINTS), len(figures.coordinates)),
        notes=(*said, *fitted.notes, *_unmeasured_support(trial, residual)),
    )


def _unmeasured_support(trial: Trial, residual: Float[Array, "frame 3"]) -> list[str]:
    """Say when the subject stood on, or held, something without a force plate (a box before a drop jump)."""
    lifted = residual[:, 1] > UNMEASURED_BW * trial.mass_kg * GRAVITY
    return [
        f"{trial.time[run.start]:.2f} to {trial.time[run.stop - 1]:.2f} s: something that no force plate "
        "measures carries the subject; forces at knees and ankles are those of hanging legs"
        for run in gap_free_runs(np.where(lifted, 0.0, np.nan))
        if run.stop - run.start > UNMEASURED_S * trial.rate_hz
    ]


def _ground_reaction(trial: Trial, foot: str) -> GroundReaction:
    k = trial.feet.index(foot)
    return GroundReaction(trial.ground_force[:, k], trial.centre_of_pressure[:, k], trial.free_torque[:, k])


class _AboutJoint(NamedTuple):
    """A joint's three angles in the ground frame: unit axes, and the inertia of the part below about them.

    ``slip`` and ``turn`` are the velocity in the joint's centre and the angular velocity, per unit speed of
    each angle, of the lowest body that the angles move (tibia, foot).
    """

    axes: Float[Array, "frame axis 3"]
    inertia: Float[Array, "frame axis axis"]
    slip: Float[Array, "frame 3 axis"]
    turn: Float[Array, "frame 3 axis"]


def _about_joint(model: _Moved, joint: JointOfModel, segments: Momenta) -> _AboutJoint:
    figures = model.figures
    columns = [model.moving.index(name) for name in joint.coordinates]
    rows = [model.watched.index(name) for name in joint.below]
    bodies = figures.rows(joint.below)
    turn, shift = np.moveaxis(model.partial[:, rows][..., columns], 2, 0)
    arms = segments.centres[:, bodies] - model.origins[:, bodies]
    shift = shift + np.cross(turn, arms[..., None], axis=2)
    axes = [turn[:, joint.below.index(mover), :, k] for k, mover in enumerate(joint.movers)]
    lever = segments.centres[:, bodies] - model.joint_centre(joint.distal)[:, None]
    while len(axes) < 3:
        axes.append(_further_axis(axes, model.rotation(joint.distal)[..., 0]))
        rigid = np.broadcast_to(axes[-1][:, None], lever.shape)
        turn = np.concatenate([turn, rigid[..., None]], axis=-1)
        shift = np.concatenate([shift, np.cross(rigid, lever)[..., None]], axis=-1)
    tensors = dynamics.inertia_in_ground(model.rotations[:, bodies], figures.inertias[bodies])
    unit = np.stack(axes, axis=1)
    unit = unit / np.linalg.norm(unit, axis=2, keepdims=True)
    inertia = dynamics.generalised_inertia(turn, shift, figures.masses[bodies], tensors)
    row = joint.below.index(joint.movers[-1])
    slip = shift[:, row] - np.cross(turn[:, row], lever[:, row, :, None], axis=1)
    return _AboutJoint(unit, inertia, slip, turn[:, row])


def _further_axis(axes: list[Array], anterior: Float[Array, "frame 3"]) -> Float[Array, "frame 3"]:
    """A unit axis that the model does not turn about: anterior beside one axis, normal to two."""
    if len(axes) == 2:
        axis = np.cross(axes[0], axes[1])
    else:
        unit = axes[0] / np.linalg.norm(axes[0], axis=1, keepdims=True)
        axis = anterior - (anterior * unit).sum(axis=1, keepdims=True) * unit
    return axis / np.linalg.norm(axis, axis=1, keepdims=True)
