"""The objective: what each loss is measured by, and their weighted sum.

The paper divides every loss by its value for the first field. That holds here for L2, L3 and, with the
paper's coupling, for L1. Three of them need a word:

* L1 with the stiffness coupling. The frontal angle is a few degrees and a soft sleeve changes it by a per
  cent: ``L1 / L1_start`` would be one for every design. Both of its sums are therefore compared with what the
  *uniform brace of the same volume* does to the same motion, in logarithms, so that one per cent counts alike
  whatever the size. Freedom (the change of the preserved angles) is what is asked for; support (what is
  taken off the prevented angles) counts a little; and the stiffness about a prevented angle shall not fall
  below the uniform brace's, by a quadratic penalty. Together they strive for the largest ratio of support to
  hindrance at equal volume and no less support, the figure of merit of a design.

  Past ``optimize.support_until_deg`` of flexion a share of the uniform brace's support is enough
  (``optimize.support_beyond``). A sleeve that is bent to a right angle is a crumpled tube: to be as firm as
  the uniform one there, it must be as firm all around, in front and behind the knee too, which is just what
  hinders flexion. In the drop jump, which goes to 110 deg, that last posture alone held the straight leg's
  ratio at 4 where it is 8 otherwise. Ligaments are hurt at small flexion, at and soon after landing (Koga et
  al. 2010, Am. J. Sports Med. 38:2218).
* L1 with the paper's coupling stays the paper's: statics fixes what both loops hold together, a design merely
  shifts it from one to the other.
* L4 and L5 are zero for a uniform field of the right volume. Their start value is not taken below that of
  a 5 % error (`TOLERANCE`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.optimize.evaluate import Evaluation, mechanics_of, support_of
from hilbrace.optimize.losses import Stability, joint_stability
from hilbrace.optimize.problem import Problem
from hilbrace.optimize.uniform import uniform_design
from hilbrace.shell import SolverPool

Array = np.ndarray

TOLERANCE = 0.05
"""Relative volume error, and jump of d across the seam, that count as one unit of loss [-]."""

SUPPORT_SHARE = 0.1
"""What a relative gain of support is worth against the same gain of freedom, once support is enough [-]."""

FLOOR_WEIGHT = 20.0
"""Penalty on the squared logarithm by which support falls below the uniform brace's [-]."""

LEAST = 1e-3
"""Relief below this share of the uniform brace's counts as this much: its logarithm would have no end [-]."""

TINY = 1e-30


@dataclass(frozen=True)
class Reference:
    """What the losses are measured by.

    Attributes:
        start: L1..L5 of the first field, L4 and L5 not below their floors.
        preserved: L1's preserved sum with the uniform brace of the target volume on [rad^2].
        relieved: What that brace takes off the prevented sum [rad^2].
        support: Stiffness about the prevented angles that is enough in each posture [N*m/rad]: that brace's,
            or a share of it past the flexion up to which a brace shall support.
    """

    start: Float[Array, " loss"]
    preserved: float
    relieved: float
    support: Float[Array, "posture angle"]


def reference(problem: Problem, first: Evaluation, solvers: SolverPool | None = None) -> Reference:
    """Take the measure of a design task.

    Args:
        problem: The design task.
        first: Losses of the first field.
        solvers: Open solvers of the shell's sparsity; own ones if left out.
    """
    start = first.terms.detach().numpy().copy()
    floors = (TINY, TINY, TINY, TOLERANCE**2, max(len(problem.domain.seam_pairs) * TOLERANCE**2, TINY))
    with torch.no_grad():
        uniform = uniform_design(problem, problem.settings.volume_fraction)
        mechanics = mechanics_of(problem, uniform.modulus, solvers)
        stability = joint_stability(
            problem.motion.angles, mechanics.prediction.change, problem.preserve, problem.prevent
        )
        support = support_of(problem, mechanics.response).numpy() * _share_wanted(problem)[:, None]
    return Reference(
        np.maximum(start, floors), float(stability.preserved), float(stability.relieved), support
    )


def _share_wanted(problem: Problem) -> Float[Array, " posture"]:
    """Share of the uniform brace's support that is wanted in each posture [-]."""
    settings = problem.settings
    flexion = np.abs(np.rad2deg([posture.flexion for posture in problem.postures]))
    return np.where(flexion <= settings.support_until_deg, 1.0, settings.support_beyond)


def normalised(evaluation: Evaluation, measure: Reference, coupling: str) -> Float[Tensor, "5"]:
    """L1..L5 as they enter the objective, each one in its own unit.

    Args:
        evaluation: Losses of a field.
        measure: What they are measured by.
        coupling: ``"stiffness"`` or ``"paper"``, see `hilbrace.optimize.coupling`.
    """
    terms = evaluation.terms / torch.from_numpy(measure.start)
    if coupling == "paper":
        return terms
    stability = relative_stability(evaluation.stability, evaluation.support, measure)
    return torch.cat([stability[None], terms[1:]])


def relative_stability(
    stability: Stability, support: Float[Tensor, "posture angle"], measure: Reference
) -> Float[Tensor, ""]:
    """L1 against the uniform brace: one for a brace like it, falling as the preserved angles are freed.

    ``1 + 1/2 log(P / P_u) - SUPPORT_SHARE log(R / R_u) + FLOOR_WEIGHT sum max(0, log(k_u / k))^2`` with the
    preserved sum P, the relief R, and the stiffness k about each prevented angle in each posture, of which
    k_u is enough.

    Args:
        stability: L1's sums.
        support: Stiffness about the prevented angles in each posture [N*m/rad].
        measure: The same of the uniform brace.
    """
    freedom = 0.5 * torch.log(stability.preserved.clamp(min=TINY) / max(measure.preserved, TINY))
    relief = stability.relieved / measure.relieved if measure.relieved > 0.0 else torch.ones(())
    lack = torch.relu(torch.log(torch.from_numpy(measure.support) / support))
    floor = FLOOR_WEIGHT * (lack**2).sum()
    return 1.0 + freedom - SUPPORT_SHARE * torch.log(relief.clamp(min=LEAST)) + floor
