"""Where the firm and the soft microstructure go, and the passage between them (paper, Sec. 3.3.2)."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Bool, Float

from hilbrace.material.blending import blend_map
from hilbrace.material.segmentation import segment
from hilbrace.optimize.evaluate import Firmness
from hilbrace.optimize.problem import Problem

Array = np.ndarray


def firmness(problem: Problem, firm: Bool[Array, " triangle"]) -> Firmness:
    """Blend the segmentation into firm fractions at triangles and cut vertices."""
    domain = problem.domain
    vertex, triangle = blend_map(domain.vertices, domain.triangles, firm, problem.blend_mm)
    return Firmness(torch.from_numpy(triangle), torch.from_numpy(vertex[domain.weld]))


def segment_by_energy(
    problem: Problem, modulus: Float[Array, " triangle"] | None = None
) -> Bool[Array, " triangle"]:
    """Firm where the skin hardly deforms, soft where it must follow the motion.

    With one modulus everywhere the energy is the motion's alone. With the moduli of the present field, as in
    the paper, it is what the brace stores; that feeds back: a place that is firm stores more for being firm,
    and may be called soft for it the next time.

    Args:
        problem: The design task.
        modulus: Modulus of the triangles, in any unit; one everywhere if left out.
    """
    domain = problem.domain
    energy, areas = problem.unit_energy.numpy(), problem.areas.numpy()
    if modulus is not None:
        energy = modulus * energy
    return segment(energy, areas, domain.triangles, domain.vertices, problem.segmentation)
