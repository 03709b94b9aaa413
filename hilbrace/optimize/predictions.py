"""What a finished design is predicted to do: by both couplings, and for other passive stiffnesses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.config import ASSUMED_PASSIVE, passive_stiffness
from hilbrace.domain.domain import Domain
from hilbrace.optimize.brace_response import BraceResponse
from hilbrace.optimize.coupling import COUPLINGS, Prediction, contact_change
from hilbrace.optimize.design import COUPLINGS as COUPLING_NAMES
from hilbrace.optimize.design import Design
from hilbrace.optimize.joint_response import joint_motion, resampling
from hilbrace.optimize.problem import Problem
from hilbrace.units import GRAVITY

Array = np.ndarray

PASSIVE_LEVELS = (0.4, 1.0, 2.0)
"""Shares of the assumed passive frontal stiffness for which the prediction is repeated [-] (2, 5 and 10
N*m/deg of a knee): it is assumed, and sets the size of every predicted change."""


@dataclass(frozen=True)
class Predictions:
    """Predictions of all couplings, in the order of `hilbrace.optimize.coupling.COUPLINGS`.

    Attributes:
        angle_change: Change of the joint's angles in the frames of the design [rad].
        contact_force_change: Change of the force between the bones of the joint [N], in the brace's frame.
        contact_moment_change: Change of their moment about the joint's centre [N*m].
        levels: Passive frontal stiffnesses for which the prediction was repeated [N*m/deg].
        sensitivity: Largest change of each angle for each of them [rad].
    """

    angle_change: Float[Array, "coupling frame 3"]
    contact_force_change: Float[Array, "coupling frame 3"]
    contact_moment_change: Float[Array, "coupling frame 3"]
    levels: Float[Array, " level"]
    sensitivity: Float[Array, "level coupling 3"]


def predict(problem: Problem, loads: JointLoads, response: BraceResponse) -> Predictions:
    """Evaluate every coupling once.

    Args:
        problem: The design task.
        loads: The loads that it was made of.
        response: What the brace answers.
    """
    levels = np.array(PASSIVE_LEVELS) * ASSUMED_PASSIVE[_kind(problem)][1]
    with torch.no_grad():
        every = [couple(problem, response) for couple in COUPLINGS.values()]
        contacts = [contact_change(prediction.force, prediction.moment) for prediction in every]
        sensitivity = [_largest(problem, loads, level, response) for level in levels]
    to_frames = _to_frames(problem)
    return Predictions(
        np.stack([to_frames @ prediction.change.numpy() for prediction in every]),
        np.stack([to_frames @ force.numpy() for force, _ in contacts]),
        np.stack([to_frames @ moment.numpy() for _, moment in contacts]),
        levels,
        np.array(sensitivity),
    )


def _largest(
    problem: Problem, loads: JointLoads, frontal_nm_per_deg: float, response: BraceResponse
) -> Float[Array, "coupling 3"]:
    """Largest change of each angle when the joint's passive frontal stiffness is another."""
    sagittal, _, axial = passive_stiffness(problem.settings, _kind(problem))
    passive = (sagittal, frontal_nm_per_deg, axial)
    motion = joint_motion(loads, problem.domain.joint, passive, problem.settings.muscle_stiffness)
    other = replace(problem, motion=motion)
    every: list[Prediction] = [couple(other, response) for couple in COUPLINGS.values()]
    to_frames = _to_frames(problem)
    return np.stack([np.abs(to_frames @ prediction.change.numpy()).max(axis=0) for prediction in every])


def _kind(problem: Problem) -> str:
    return problem.domain.joint.split("_")[0]


def _to_frames(problem: Problem) -> Float[Array, "frame instant"]:
    """Weights from the clock of the joint's motion to the frames of the design."""
    return resampling(problem.motion.time.numpy(), problem.domain.time)


def prediction_figures(design: Design, loads: JointLoads, domain: Domain) -> dict[str, Any]:
    """What the design is predicted to do, in figures that people read.

    The change of the peak contact force is left out (None) where muscle and contact forces are not known.

    Args:
        design: The finished design.
        loads: Loads of the joints.
        domain: The brace's surface and the frames of the design.
    """
    weight = loads.body_mass_kg * GRAVITY
    contact = loads.contact_force[:, loads.joints.index(domain.joint)]
    resting = resampling(loads.time, domain.time) @ contact
    every: dict[str, dict[str, float | None]] = {}
    for index, coupling in enumerate(COUPLING_NAMES):
        change, force = design.angle_changes[index], design.contact_force_change[index]
        peak = _peak(resting + force) - _peak(resting)
        every[coupling] = {
            **_degrees(np.abs(change).max(axis=0)),
            "contact_force_change_max_n": _significant(_peak(force)),
            "contact_force_peak_change_bw": _significant(peak / weight) if np.isfinite(peak) else None,
        }
    rows = zip(design.passive_levels, design.passive_sensitivity, strict=True)
    return {
        "coupling": design.coupling,
        "predicted_by_coupling": every,
        "passive_sensitivity": [
            {
                "passive_frontal_nm_per_deg": float(level),
                **{name: _degrees(row) for name, row in zip(COUPLING_NAMES, largest, strict=True)},
            }
            for level, largest in rows
        ],
    }


def _degrees(largest: Float[Array, "3"]) -> dict[str, float | None]:
    planes = ("sagittal", "frontal", "axial")
    return {
        f"{plane}_change_max_deg": _significant(value)
        for plane, value in zip(planes, np.rad2deg(largest), strict=True)
    }


def _peak(vectors: Float[Array, "frame 3"]) -> float:
    return float(np.linalg.norm(vectors, axis=1).max())


def _significant(value: float) -> float:
    return float(f"{value:.4g}")
