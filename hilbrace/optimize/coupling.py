"""The two ways in which a brace acts on the joint, from the shell to the angles and the contact force.

* ``"paper"``: the acting force loads the shell, its loops are held, and what they hold with acts back on the
  bones (paper, Eq. 3). The load that the brace carries comes from the bone above the joint (Eq. 1: force of
  the proximal on the distal segment), so that this bone feels its counterpart besides the upper loop's
  reaction, and the brace as a whole leaves the limb in balance: what it adds above the joint is the opposite
  of the lower loop's wrench.
* ``"stiffness"``: the loops move with the bones, and the brace resists as its condensed stiffness says. In
  the paper's form statics fixes the sum of the reactions whatever the design; in this form the design acts.

Both are a model's predictions, compared with the same model unbraced.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.optimize.brace_response import BraceResponse
from hilbrace.optimize.joint_response import (
    FLEXION,
    angle_change,
    angle_change_by_wrench,
    resampling,
    stiffness_along,
)
from hilbrace.optimize.problem import Problem
from hilbrace.shell import ShellModel, family_wrenches_at, joint_stiffness
from hilbrace.shell.loops import rotation_about
from hilbrace.units import MM_PER_M

_JOINT = np.zeros(3)
"""Where the domain puts the joint centre [mm]."""


class BraceSpring(NamedTuple):
    """A brace as a spring at the joint, in each posture of a problem.

    Attributes:
        stiffness: Moment about each angle that turns the joint by one radian [N*m/rad].
        pull: Force of the lower loop on the part below the joint per radian of each angle [N/rad].
    """

    stiffness: Float[Tensor, "posture 3 3"]
    pull: Float[Tensor, "posture 3 3"]


@dataclass(frozen=True)
class Prediction:
    """What one coupling predicts, on the clock of the joint's motion.

    Attributes:
        change: Change of the joint's angles [rad].
        force: Force of the brace on the part below the joint [N], in the brace's frame.
        moment: Its moment about the joint's centre [N*m].
    """

    change: Float[Tensor, "instant 3"]
    force: Float[Tensor, "instant 3"]
    moment: Float[Tensor, "instant 3"]


def contact_change(
    force: Float[Tensor, "instant 3"],
    moment: Float[Tensor, "instant 3"],
    arm: Float[Tensor, "*instant 3"] | None = None,
) -> tuple[Float[Tensor, "instant 3"], Float[Tensor, "instant 3"]]:
    """Change of the joint's contact force and moment by a brace, motion and muscle forces held.

    By Newton and Euler for the part below the joint, whatever the brace adds there is taken off the contact:
    ``dF = -F``, ``dM = -(M + arm x F)``. It is exact; a joint reaction analysis that applies the brace as an
    external force would first let it change the accelerations.

    Args:
        force: Force of the brace on the part below the joint [N].
        moment: Its moment about the point where the force is taken to act [N*m].
        arm: That point from the joint's centre [m]; the centre itself if left out.

    Returns:
        Change of the force of the proximal on the distal bone [N] and of the moment about the joint's centre
        [N*m].
    """
    if arm is None:
        return -force, -moment
    return -force, -(moment + torch.linalg.cross(arm.expand_as(force), force))


def brace_spring(problem: Problem, loops: Float[Tensor, "posture 12 12"]) -> BraceSpring:
    """The brace's stiffness at the joint in every posture of the problem.

    Args:
        problem: The design task.
        loops: Stiffness between the loops in every posture.
    """
    stiffness = [
        joint_stiffness(k, p.shell, p.axes, _JOINT) for k, p in zip(loops, problem.postures, strict=True)
    ]
    pull = [_pull(k, p.shell, p.axes) for k, p in zip(loops, problem.postures, strict=True)]
    return BraceSpring(torch.stack(stiffness) / MM_PER_M, torch.stack(pull))


def predict_by_stiffness(problem: Problem, response: BraceResponse) -> Prediction:
    """Let the joint move against the brace's stiffness.

    The stiffness is a tangent about each posture. The joint feels it axis by axis: a coupling term times the
    whole flexion would be a torque that no sleeve exerts, and a design could be tuned to it. The force that
    goes with the moments is the tangent's, an estimate of its size.

    Args:
        problem: The design task.
        response: What the brace answers.
    """
    motion = problem.motion
    spring = brace_spring(problem, response.loops)
    flexions = torch.tensor([posture.flexion for posture in problem.postures], dtype=torch.float64)
    direct = torch.diag_embed(torch.diagonal(spring.stiffness, dim1=1, dim2=2))
    along = stiffness_along(motion.angles[:, FLEXION], flexions, direct)
    change = angle_change(motion, along)
    turned = motion.angles + change
    pull = stiffness_along(motion.angles[:, FLEXION], flexions, spring.pull)
    force = torch.einsum("tij,tj->ti", pull, turned)
    torque = -torch.einsum("tij,tj->ti", along, turned)
    moment = torch.linalg.solve(motion.jacobian[:, 3:].transpose(1, 2), torque)
    return Prediction(change, force, moment)


def predict_by_reactions(problem: Problem, response: BraceResponse) -> Prediction:
    """Let the reactions of the loaded shell act on the bones (paper, Eq. 3 and Sec. 3.3.1).

    The reactions are known in the frames of the design and taken as linear between them.

    Args:
        problem: The design task.
        response: What the brace answers.
    """
    motion = problem.motion
    held = family_wrenches_at(response.frames.reactions, problem.shapes, _JOINT)
    clock = torch.from_numpy(resampling(problem.domain.time, motion.time.numpy()))
    lower = -(clock @ held[:, 6:])
    force, moment = lower[:, :3], lower[:, 3:] / MM_PER_M
    change = angle_change_by_wrench(motion, torch.cat([force, moment], dim=1))
    return Prediction(change, force, moment)


Coupling = Callable[[Problem, BraceResponse], Prediction]

COUPLINGS: dict[str, Coupling] = {"stiffness": predict_by_stiffness, "paper": predict_by_reactions}
"""The couplings by their names in ``optimize.coupling``, in the order of `hilbrace.optimize.design`."""


def _pull(
    loops: Float[Tensor, "12 12"], shell: ShellModel, axes: Float[np.ndarray, "axis 3"]
) -> Float[Tensor, "3 axis"]:
    """Force of the lower loop on the limb per radian about each axis [N/rad]."""
    turn = torch.from_numpy(rotation_about(shell.centres, _JOINT, axes))
    return -(loops[6:9] @ turn)
