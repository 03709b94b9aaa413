"""What a finished design is predicted to do: by both couplings, and for other passive stiffnesses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.optimize.coupling import COUPLINGS, Prediction, contact_change
from hilbrace.optimize.joint_response import joint_motion, resampling
from hilbrace.optimize.problem import Problem, passive_stiffness
from hilbrace.shell import ShellResponse

Array = np.ndarray

PASSIVE_LEVELS = (2.0, 5.0, 10.0)
"""Passive frontal stiffness for which the prediction is repeated [N*m/deg]: it is assumed, and sets the size
of every predicted change."""


@dataclass(frozen=True)
class Predictions:
    """Predictions of all couplings, in the order of `hilbrace.optimize.coupling.COUPLINGS`.

    Attributes:
        angle_change: Change of the joint's angles in the frames of the design [rad].
        contact_force_change: Change of the force between the bones of the joint [N], in the brace's frame.
        contact_moment_change: Change of their moment about the joint's centre [N*m].
        sensitivity: Largest change of each angle for each of `PASSIVE_LEVELS` [rad].
    """

    angle_change: Float[Array, "coupling frame 3"]
    contact_force_change: Float[Array, "coupling frame 3"]
    contact_moment_change: Float[Array, "coupling frame 3"]
    sensitivity: Float[Array, "level coupling 3"]


def predict(
    problem: Problem, loads: JointLoads, modulus: Float[Tensor, " triangle"], response: ShellResponse
) -> Predictions:
    """Evaluate every coupling once.

    Args:
        problem: The design task.
        loads: The loads that it was made of.
        modulus: Young's modulus of the triangles [MPa].
        response: The shell's response in the rest shape.
    """
    with torch.no_grad():
        every = [couple(problem, modulus, response) for couple in COUPLINGS.values()]
        contacts = [contact_change(prediction.force, prediction.moment) for prediction in every]
        sensitivity = [_largest(problem, loads, level, modulus, response) for level in PASSIVE_LEVELS]
    to_frames = resampling(problem.motion.time.numpy(), problem.domain.time)
    return Predictions(
        np.stack([to_frames @ prediction.change.numpy() for prediction in every]),
        np.stack([to_frames @ force.numpy() for force, _ in contacts]),
        np.stack([to_frames @ moment.numpy() for _, moment in contacts]),
        np.array(sensitivity),
    )


def _largest(
    problem: Problem,
    loads: JointLoads,
    frontal_nm_per_deg: float,
    modulus: Float[Tensor, " triangle"],
    response: ShellResponse,
) -> Float[Array, "coupling 3"]:
    """Largest change of each angle when the joint's passive frontal stiffness is another."""
    sagittal, _, axial = passive_stiffness(problem.settings)
    motion = joint_motion(loads, problem.domain.joint, (sagittal, frontal_nm_per_deg, axial))
    other = replace(problem, motion=motion)
    every: list[Prediction] = [couple(other, modulus, response) for couple in COUPLINGS.values()]
    return np.stack([prediction.change.abs().amax(dim=0).numpy() for prediction in every])
