"""The brace that a design is compared with: one microstructure, one density, the same volume."""

from __future__ import annotations

import torch

from hilbrace.optimize.evaluate import Material, fraction_of, material_of
from hilbrace.optimize.problem import Problem


def uniform_design(problem: Problem, fraction: float) -> Material:
    """One volume fraction of the firm microstructure everywhere but in the rims.

    This is the unoptimized brace of the paper's comparison, a uniform Voronoi pattern with the same solid
    rims. The limits of casting do not bind it.

    Args:
        problem: The design task.
        fraction: Volume fraction that it shall have, rims included [-].
    """
    firm = torch.ones_like(problem.areas)
    low, high = -0.5, 1.5
    for _ in range(80):
        middle = 0.5 * (low + high)
        made = material_of(problem, torch.full_like(problem.areas, middle), firm)
        low, high = (middle, high) if fraction_of(problem, made) < fraction else (low, middle)
    return material_of(problem, torch.full_like(problem.areas, 0.5 * (low + high)), firm)
