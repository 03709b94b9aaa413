"""What the brace answers for one modulus: to the loads of all frames, and to the joint in all postures."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.optimize.problem import Problem
from hilbrace.shell import FamilyResponse, ShellFamily, SolverPool, family_response, family_stiffness


@dataclass(frozen=True)
class BraceResponse:
    """The shell's answers.

    Attributes:
        frames: Compliance and reactions of every frame, in the shape that stands for it.
        loops: Stiffness between the loops in every posture [N/mm, N, N*mm/rad].
    """

    frames: FamilyResponse
    loops: Float[Tensor, "posture 12 12"]


def brace_response(
    problem: Problem, modulus: Float[Tensor, " triangle"], solvers: SolverPool | None = None
) -> BraceResponse:
    """Solve every shape of the brace once, side by side; on the shape of a posture no load need act.

    Args:
        problem: The design task.
        modulus: Young's modulus of the triangles [MPa].
        solvers: Open solvers of the shell's sparsity; own ones if left out.

    Raises:
        SolverError: The modulus is not positive and finite, or the stiffness is singular.
    """
    loaded = {id(shell) for shell in problem.shapes.shells}
    others = [posture.shell for posture in problem.postures if id(posture.shell) not in loaded]
    every = ShellFamily((*problem.shapes.shells, *others), problem.shapes.shape_of_frame)
    frames = family_response(modulus, every, problem.load, solvers=solvers)
    known = {id(shell): k for shell, k in zip(every.shells, frames.loop_stiffness, strict=True)}
    return BraceResponse(frames, torch.stack([known[id(posture.shell)] for posture in problem.postures]))


def posture_stiffness(
    problem: Problem, modulus: Float[Tensor, " triangle"], solvers: SolverPool | None = None
) -> Float[Tensor, "posture 12 12"]:
    """Stiffness between the loops in every posture alone [N/mm, N, N*mm/rad]."""
    return family_stiffness(modulus, [posture.shell for posture in problem.postures], solvers=solvers)
