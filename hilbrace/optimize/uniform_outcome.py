"""What the uniform brace does in a design task, in the figures of a finished design."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from hilbrace.biomech.joint_loads import JointLoads
from hilbrace.optimize.design import COUPLINGS
from hilbrace.optimize.evaluate import evaluate_material, fraction_of
from hilbrace.optimize.predictions import predict
from hilbrace.optimize.problem import Problem
from hilbrace.optimize.uniform import uniform_design
from hilbrace.shell import open_pool

Array = np.ndarray


@dataclass(frozen=True)
class UniformOutcome:
    """The uniform brace as a design would be told.

    Attributes:
        d: Its design variable, the same everywhere [-].
        losses: L1..L5, not normalised.
        angle_change: Predicted change of the joint's angles per frame by the task's coupling [rad].
        volume_fraction: Mean volume fraction, rims included [-].
    """

    d: float
    losses: Float[Array, " loss"]
    angle_change: Float[Array, "frame 3"]
    volume_fraction: float


def uniform_outcome(problem: Problem, loads: JointLoads, fraction: float) -> UniformOutcome:
    """Evaluate the uniform brace, the firm microstructure in one density, in a design task.

    Args:
        problem: The design task.
        loads: The loads that it was made of.
        fraction: Volume fraction that the brace shall have [-].
    """
    material = uniform_design(problem, fraction)
    d = float(material.d[0])
    with open_pool(problem.shapes.shells[0].numbering.sparsity, problem.settings.solver) as solvers:
        with torch.no_grad():
            everywhere = torch.full((len(problem.domain.uv),), d, dtype=torch.float64)
            evaluation = evaluate_material(problem, material, everywhere, solvers)
        predicted = predict(problem, loads, evaluation.mechanics.response)
    own = COUPLINGS.index(problem.settings.coupling)
    return UniformOutcome(
        d, evaluation.terms.numpy(), predicted.angle_change[own], fraction_of(problem, material)
    )
