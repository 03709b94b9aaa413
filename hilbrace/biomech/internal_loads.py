"""Inside the joints: muscle forces and contact forces of a motion whose net loads are known."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline

from hilbrace.biomech import contact
from hilbrace.biomech.contact import Crossing
from hilbrace.biomech.dynamics import time_derivative
from hilbrace.biomech.engine import Engine
from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.biomech.muscles import MuscleFigures, balanced_coordinates, recruit
from hilbrace.config import BiomechSettings
from hilbrace.errors import InputError
from hilbrace.units import DEG

Array = np.ndarray

ARM_STEP = 2.0 * DEG
"""Change of an angle over which the change of moment arms is measured [rad]; smaller ones hit the kinks of
paths that lift off a wrap."""
ARM_SPACING_S = 0.05
"""Time between the poses in which that is done [s]."""


def with_muscles(
    engine: Engine,
    loads: JointLoads,
    rate_hz: float,
    parts: Sequence[Sequence[str]],
    angles: Sequence[Sequence[str]],
    centres: Float[Array, "frame joint 3"],
    reactions: Mapping[str, Float[Array, "frame 6"]],
    settings: BiomechSettings,
) -> JointLoads:
    """Add muscle and contact forces to the net loads of a motion.

    Args:
        engine: Engine that holds the model.
        loads: Net loads, without muscles; its acting force is the intersegmental one.
        rate_hz: Frames per second [Hz].
        parts: Bodies below each joint.
        angles: Coordinates of each joint.
        centres: Centre of each joint in the ground [m].
        reactions: Force of the ground [N] and moment about the origin of the ground [N*m], by body.
        settings: What muscle forces minimise, and how kneecaps transmit force.

    Returns:
        The record with the fields of muscles and contact filled, and the acting force by its convention.

    Raises:
        InputError: The literal convention is asked of a joint that no muscle crosses.
        SolverError: Muscle forces do not converge.
    """
    speeds = time_derivative(loads.coordinates, rate_hz)
    moments = engine.call(
        "inverse_dynamics",
        coordinates=loads.coordinates,
        speeds=speeds,
        accelerations=time_derivative(speeds, rate_hz),
        loads=dict(reactions),
    )
    figures = MuscleFigures(**engine.call("muscle_figures"))
    rows, locked = balanced_coordinates(loads.coordinate_names, loads.coordinates)
    paths = engine.call("muscle_paths", coordinates=loads.coordinates, speeds=speeds, rows=rows, parts=parts)
    across = [
        contact.crossing(paths["pulls"][:, k], loads.distal_rotation[:, k], centres[:, k])
        for k in range(len(loads.joints))
    ]
    crossed = [bool(np.any(part.pull)) for part in across]
    if settings.kneecap == "lever":
        across = _through_kneecaps(loads, across, paths["arms"], rows)
    _check_literal(loads, crossed)
    surfaces = {
        joint: (across[k], loads.acting_force[:, k], loads.acting_moment[:, k])
        for k, joint in enumerate(loads.joints)
        if settings.muscle_criterion == "activation_and_contact" and crossed[k]
    }
    columns = [loads.coordinate_names.index(name) for name in rows]
    found = recruit(paths["capacity"], paths["arms"], moments[:, columns], rows, surfaces, figures)
    reserve = moments.copy()
    reserve[:, columns] -= np.einsum("frm,fm->fr", paths["arms"], found.tension)
    arms = _arms_of_joints(paths["arms"], rows, angles)
    return dataclasses.replace(
        loads,
        joint_moment=moments,
        reserve=reserve,
        muscle_names=figures.names,
        muscle_max_force=figures.max_force,
        muscle_optimal_length=figures.optimal_length,
        muscle_slack_length=figures.slack_length,
        muscle_activation=found.activation,
        muscle_force=found.tension,
        muscle_arms=arms,
        muscle_pull=np.stack([part.pull for part in across], axis=1),
        geometric_stiffness=_geometric_stiffness(
            engine, loads, figures, arms, angles, found.tension, rate_hz
        ),
        **_contact_fields(loads, across, crossed, found.tension),
        notes=(*loads.notes, *_notes(loads, figures, crossed, locked)),
    )


def _through_kneecaps(
    loads: JointLoads,
    across: Sequence[Crossing],
    arms: Float[Array, "frame row muscle"],
    rows: Sequence[str],
) -> list[Crossing]:
    result = list(across)
    for k, joint in enumerate(loads.joints):
        name = f"knee_angle_{joint[-1]}"
        if joint.startswith("knee") and name in rows:
            flexion = loads.distal_jacobian[:, k, :, 0]
            result[k] = contact.through_kneecap(across[k], flexion, arms[:, rows.index(name)])
    return result


def _check_literal(loads: JointLoads, crossed: Sequence[bool]) -> None:
    lacking = [joint for joint, found in zip(loads.joints, crossed, strict=True) if not found]
    if loads.convention == "paper_literal" and lacking:
        raise InputError(
            f"no muscle of the model crosses {', '.join(lacking)}",
            where="biomech.convention = 'paper_literal'",
            hint="use biomech.convention = 'intersegmental', which needs no muscles",
        )


def _contact_fields(
    loads: JointLoads,
    across: Sequence[Crossing],
    crossed: Sequence[bool],
    tension: Float[Array, "frame muscle"],
) -> dict[str, Any]:
    """Contact and acting loads of every joint; contact is NaN where no muscle crosses."""
    acting, acting_moment = loads.acting_force.copy(), loads.acting_moment.copy()
    force, moment = np.full_like(acting, np.nan), np.full_like(acting, np.nan)
    medial, lateral = np.full(acting.shape[:2], np.nan), np.full(acting.shape[:2], np.nan)
    for k, (joint, part) in enumerate(zip(loads.joints, across, strict=True)):
        if not crossed[k]:
            continue
        force[:, k] = acting[:, k] - np.einsum("fmi,fm->fi", part.pull, tension)
        moment[:, k] = acting_moment[:, k] - np.einsum("fmi,fm->fi", part.turn, tension)
        if joint.startswith("knee"):
            medial[:, k], lateral[:, k] = contact.compartments(force[:, k], moment[:, k], joint)
        acting[:, k] = contact.acting_force(acting[:, k], part.pull, tension, loads.convention)
        acting_moment[:, k] = contact.acting_force(acting_moment[:, k], part.turn, tension, loads.convention)
    return {
        "acting_force": acting,
        "acting_moment": acting_moment,
        "contact_force": force,
        "contact_moment": moment,
        "contact_medial": medial,
        "contact_lateral": lateral,
    }


def _arms_of_joints(
    arms: Float[Array, "frame row muscle"], rows: Sequence[str], angles: Sequence[Sequence[str]]
) -> Float[Array, "frame joint 3 muscle"]:
    """Moment arms about the angles of each joint; zero about angles that the model does not have."""
    result = np.zeros((len(arms), len(angles), 3, arms.shape[2]))
    for k, names in enumerate(angles):
        for axis, name in enumerate(names):
            if name in rows:
                result[:, k, axis] = arms[:, rows.index(name)]
    return result


def _geometric_stiffness(
    engine: Engine,
    loads: JointLoads,
    figures: MuscleFigures,
    arms: Float[Array, "frame joint 3 muscle"],
    angles: Sequence[Sequence[str]],
    tension: Float[Array, "frame muscle"],
    rate_hz: float,
) -> Float[Array, "frame joint 3 3"]:
    """Stiffness by moment arms that change with the angles, -sum F dR/dq [N*m/rad].

    Both sides are moved at once, since no muscle crosses joints of both. Arms are measured in poses
    `ARM_SPACING_S` apart and their changes interpolated; those of muscles that do not cross do not change.
    """
    result = np.zeros((*arms.shape[:2], 3, 3))
    frames = np.arange(len(arms))
    poses = np.unique([*frames[:: max(1, round(ARM_SPACING_S * rate_hz))], frames[-1]])
    for turned, joints in _moved_together(loads.joints, angles):
        crossing = np.flatnonzero(np.abs(arms[:, joints]).max(axis=(0, 1, 2), initial=0.0) > contact.NO_PULL)
        if not len(crossing):
            continue
        names = [name for k in joints for name in angles[k]]
        step = np.zeros(loads.coordinates.shape[1])
        step[[loads.coordinate_names.index(name) for name in turned]] = ARM_STEP
        low, high = (
            engine.call(
                "moment_arms",
                coordinates=loads.coordinates[poses] + change,
                rows=names,
                names=[figures.names[k] for k in crossing],
            )
            for change in (-step, step)
        )
        slope = make_interp_spline(poses, (high - low) / (2.0 * ARM_STEP), k=1)(frames)
        for k in joints:
            for axis, name in enumerate(angles[k]):
                if name in turned:
                    rows = [names.index(other) for other in angles[k]]
                    change = np.einsum("frm,fm->fr", slope[:, rows], tension[:, crossing])
                    result[:, k, : len(rows), axis] = -change
    return 0.5 * (result + np.swapaxes(result, 2, 3))


def _moved_together(
    joints: Sequence[str], angles: Sequence[Sequence[str]]
) -> list[tuple[list[str], list[int]]]:
    """Coordinates by kind of joint and axis, right and left together, and the numbers of their joints."""
    together: dict[tuple[str, int], tuple[list[str], list[int]]] = {}
    for k, (joint, names) in enumerate(zip(joints, angles, strict=True)):
        for axis, name in enumerate(names):
            turned, owners = together.setdefault((joint.split("_")[0], axis), ([], []))
            turned.append(name)
            owners.append(k)
    return list(together.values())


def _notes(
    loads: JointLoads, figures: MuscleFigures, crossed: Sequence[bool], locked: Sequence[str]
) -> list[str]:
    notes = []
    lacking = [joint for joint, found in zip(loads.joints, crossed, strict=True) if not found]
    if not figures.names:
        notes.append("the model has no muscles: contact forces are not known; net loads are")
    elif lacking:
        notes.append(
            f"no muscle of the model crosses {', '.join(lacking)}: contact forces there are not known"
        )
    if locked and figures.names:
        notes.append(f"{', '.join(locked)}: locked in the model, so that no muscle was asked for its moment")
    return notes
