"""Which loss wants the brace firm, and where: the losses' own derivatives on the finished design."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from hilbrace.optimize.design import LOSSES, Design
from hilbrace.optimize.evaluate import Firmness, evaluate_material, material_of
from hilbrace.optimize.objective import Reference, normalised
from hilbrace.optimize.problem import Problem
from hilbrace.shell import SolverPool

Array = np.ndarray


def pulls(
    problem: Problem,
    firm: Firmness,
    d: Float[Array, " triangle"],
    d_vertex: Float[Array, " cut_vertex"],
    measure: Reference,
    solvers: SolverPool | None = None,
) -> Float[Array, "loss triangle"]:
    """Fall of every weighted loss per rise of the design variable, triangle by triangle.

    ``-w_i (dL_i / dd_e) (A / A_e)`` with the weights ``w_i``, the normalised losses and the share ``A_e / A``
    of the triangle in the brace's area, so that the figures do not depend on the mesh. Positive where a loss
    wants the brace firmer. In a free optimum the pulls of a triangle sum up to zero; where the design
    variable is at a limit, and where the field is too smooth to follow, they do not. The seam's loss acts on
    vertices and has none.

    Args:
        problem: The design task.
        firm: The firm and soft map.
        d: Design variable at triangle centres [-].
        d_vertex: Design variable at the cut vertices [-].
        measure: What the losses are measured by.
        solvers: Open solvers of the shell's sparsity; own ones if left out.
    """
    moving = torch.from_numpy(d.copy()).requires_grad_()
    material = material_of(problem, moving, firm.triangles)
    evaluation = evaluate_material(problem, material, torch.from_numpy(d_vertex), solvers)
    terms = normalised(evaluation, measure, problem.settings.coupling)
    share = (problem.areas / problem.areas.sum()).numpy()
    found = np.zeros((len(LOSSES), len(d)))
    for place, weight in enumerate(problem.settings.weights.model_dump().values()):
        if weight > 0.0 and terms[place].requires_grad:
            (slope,) = torch.autograd.grad(terms[place], moving, retain_graph=True, allow_unused=True)
            if slope is not None:
                found[place] = -weight * slope.numpy() / share
    return found


def shares_of_pull(design: Design, areas: Float[Array, " triangle"], firmer: bool) -> Float[Array, " loss"]:
    """Share of each loss in what pulls a part of the brace one way [-]; zero for those that pull the other.

    Args:
        design: The finished design.
        areas: Areas of the part's triangles, zero for those outside.
        firmer: Whether to ask for the pull towards firm, or towards open.
    """
    total = design.pulls @ areas * (1.0 if firmer else -1.0)
    wanted = np.maximum(total, 0.0)
    return wanted / max(float(wanted.sum()), 1e-300)
