"""The biomechanics stage: from a recorded motion to the loads across and inside knees and ankles.

Scale, calibrate and follow (`kinematics`), low-pass the coordinates, then Newton-Euler (`dynamics`) for the
net loads, muscles and contact (`internal_loads`). The acting force is the net force of the proximal on the
distal segment: muscles count as their pull on the proximal bone, so that contact force less muscle forces is
what the segments below need to move as they do against the ground reaction (paper, Eq. 1). It needs no
estimate of single muscles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hilbrace.biomech import dynamics
from hilbrace.biomech.dynamics import GroundReaction, Momenta
from hilbrace.biomech.engine import Engine, Report
from hilbrace.biomech.internal_loads import with_muscles
from hilbrace.biomech.joint_loads import JOINTS, JointLoads, without_muscles
from hilbrace.biomech.kinematics import Kinematics, follow
from hilbrace.biomech.model_figures import ModelFigures
from hilbrace.biomech.residuals import (
    pelvis_residual,
    residual_figures,
    residual_notes,
    unmeasured_support,
)
from hilbrace.biomech.subject_model import subject_model
from hilbrace.body.body import Body
from hilbrace.config import BiomechSettings, MotionSettings
from hilbrace.motion.filters import lowpass
from hilbrace.motion.marker_maps import MarkerMap
from hilbrace.motion.trial import Trial
from hilbrace.run.progress import silent

Array = np.ndarray

SIDE = {"r": "right", "l": "left"}


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
    """Angles, net loads, muscle and contact forces of knees and ankles, per frame.

    The model is the built-in one, scaled by the body's factors and mass, or the user's (``biomech.model``);
    see `hilbrace.biomech.subject_model.subject_model`.

    Args:
        trial: The motion, its forces filtered.
        body: The subject's segment scales and mass.
        marker_map: Meaning of the marker names.
        motion: Cut-off frequency.
        biomech: Model and regularisation of the knees.
        progress: Called with (done, total) frames of the fit.

    Raises:
        InputError: Markers do not suffice, or the model does not fit the subject.
        SolverError: The fit or the OpenSim process fails.
    """
    hold = biomech.knee_regularisation
    with Engine() as engine:
        figures, markers, start, said = subject_model(engine, trial, body, marker_map, biomech)
        fitted = follow(engine, figures, trial, markers, start, hold, progress)
        smooth = lowpass(fitted.coordinates, trial.rate_hz, motion.cutoff_hz)
        poses = engine.call("poses", coordinates=smooth)
        joints = joints_of_model(figures)
        moving = tuple(name for joint in joints for name in joint.coordinates)
        watched = tuple(dict.fromkeys(name for joint in joints for name in joint.below))
        partial = engine.call("partial_velocities", coordinates=smooth, moving=moving, bodies=watched)
        model = _Moved(figures, poses["rotations"], poses["origins"], moving, watched, partial)
        loads = _loads(trial, model, smooth, fitted, said, motion.cutoff_hz, biomech.convention)
        return with_muscles(
            engine,
            loads,
            trial.rate_hz,
            parts=[joint.below for joint in joints],
            angles=[joint.coordinates for joint in joints],
            centres=np.stack([model.joint_centre(joint.distal) for joint in joints], axis=1),
            reactions={f"calcn_{foot[0]}": _about_ground(trial, foot) for foot in trial.feet},
            settings=biomech,
        )


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
    pelvis = model.origins[:, figures.bodies.index("pelvis")]
    residual = pelvis_residual(segments, [_ground_reaction(trial, foot) for foot in trial.feet], pelvis)
    carried = unmeasured_support(residual.force, trial.mass_kg, trial.rate_hz)
    ends = round(trial.rate_hz / (2.0 * cutoff_hz))
    judged = residual_figures(trial.time, residual, trial.ground_force.sum(axis=1), segments, carried, ends)
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
        marker_bodies=fitted.marker_bodies,
        marker_error=fitted.marker_error,
        cutoff_hz=cutoff_hz,
        pelvis_residual_force=residual.force,
        pelvis_residual_moment=residual.moment,
        residuals=judged,
        **without_muscles(len(trial.time), len(JOINTS), len(figures.coordinates)),
        notes=(*said, *fitted.notes, *residual_notes(judged, trial.time, carried)),
    )


def _ground_reaction(trial: Trial, foot: str) -> GroundReaction:
    k = trial.feet.index(foot)
    return GroundReaction(trial.ground_force[:, k], trial.centre_of_pressure[:, k], trial.free_torque[:, k])


def _about_ground(trial: Trial, foot: str) -> Float[Array, "frame 6"]:
    """Force of the ground on a foot, and its moment about the origin of the ground."""
    reaction = _ground_reaction(trial, foot)
    moment = np.cross(reaction.point, reaction.force) + reaction.torque
    return np.concatenate([reaction.force, moment], axis=1)


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
