"""The design loop: Adam on the field's parameters, with checkpoints that a killed run goes on from.

All that the loop carries from one iteration to the next is in `Progress`; it is saved and read back bit for
bit, so that an interrupted run ends in the same design as an undisturbed one.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hilbrace.errors import InputError, SolverError
from hilbrace.field import project_to_volume
from hilbrace.material.blending import blend_map
from hilbrace.material.segmentation import segment
from hilbrace.optimize.design import LOSSES
from hilbrace.optimize.evaluate import CONTRAST, Evaluation, Firmness, evaluate, material_of
from hilbrace.optimize.objective import Reference, normalised, reference
from hilbrace.optimize.problem import Problem, width_limits
from hilbrace.run.progress import Report
from hilbrace.run.records import load, save
from hilbrace.shell import SolverPool

Array = np.ndarray

START_NOISE = 0.02
"""Standard deviation of the first parameters [-]; the seed's only use."""

LAST_STEP = 0.1
"""Step of the last iteration over that of the first; in between it falls as a cosine."""

STEP_LIMIT = 1.0
"""Largest norm of the gradient; a longer one is shortened."""


@dataclass(frozen=True)
class Progress:
    """The state of the loop between two iterations.

    Attributes:
        key: Key of the stage that this belongs to.
        iteration: Iterations done.
        theta: Parameters of the field.
        bias: Level of the field.
        momentum: First and second moments of Adam: theta's, then the bias's, flattened.
        firm: The segmentation: True is firm.
        history: Normalised L1..L5 and total, one row per iteration.
        losses_initial: L1..L5 of the first field.
        measure: L1..L5 by which losses are divided, see `objective.Reference`; zero before the first.
        uniform: L1's preserved sum and relief of the uniform brace [rad^2].
        support: Stiffness of the uniform brace about the prevented angles in each posture [N*m/rad].
    """

    key: str
    iteration: int
    theta: Float[Array, "*layer"]
    bias: Float[Array, ""]
    momentum: Float[Array, "2 parameter"]
    firm: Bool[Array, " triangle"]
    history: Float[Array, "iteration term"]
    losses_initial: Float[Array, " loss"]
    measure: Float[Array, " loss"]
    uniform: Float[Array, "2"]
    support: Float[Array, "posture angle"]


def run_loop(
    problem: Problem, checkpoint: Path, key: str, report: Report, solvers: SolverPool | None = None
) -> tuple[Progress, Firmness, Evaluation, float]:
    """Optimize, going on from a checkpoint of the same stage if there is one.

    Args:
        problem: The design task.
        checkpoint: File for the checkpoints.
        key: Key of the stage.
        report: Called with (iterations done, iterations in all).
        solvers: Open solvers of the shell's sparsity; own ones for every iteration if left out.

    Returns:
        The last state, its firm map and losses, and the median time of an iteration [s].

    Raises:
        SolverError: A loss is not finite.
    """
    settings = problem.settings
    state = _resume(checkpoint, key) or first_state(problem, key)
    firm = firmness(problem, state.firm)
    seconds: list[float] = []
    while state.iteration < settings.iterations:
        start = time.perf_counter()
        state = _step(problem, firm, state, solvers)
        seconds.append(time.perf_counter() - start)
        if state.iteration % settings.checkpoint_every == 0:
            save(state, checkpoint)
        report(state.iteration, settings.iterations)
    with torch.no_grad():
        last = evaluate(problem, firm, *_tensors(state), solvers)
        row, _ = _normalised(problem, last, state)
    closed = replace(state, history=np.concatenate([state.history, row.numpy()[None]]))
    return closed, firm, last, float(np.median(seconds)) if seconds else 0.0


def first_state(problem: Problem, key: str) -> Progress:
    """The first field: uniform at the target volume, but for a trace of noise from the seed."""
    settings = problem.settings
    theta = problem.triangles.field.start(settings.seed, START_NOISE).numpy()
    firm = segment_by_energy(problem)
    bias = level_for_volume(problem, firmness(problem, firm), torch.from_numpy(theta))
    return Progress(
        key=key,
        iteration=0,
        theta=theta,
        bias=np.array(bias),
        momentum=np.zeros((2, theta.size + 1)),
        firm=firm,
        history=np.zeros((0, len(LOSSES) + 1)),
        losses_initial=np.zeros(5),
        measure=np.zeros(5),
        uniform=np.zeros(2),
        support=np.zeros((0, 0)),
    )


def firmness(problem: Problem, firm: Bool[Array, " triangle"]) -> Firmness:
    """Blend the segmentation into firm fractions at triangles and cut vertices."""
    domain = problem.domain
    vertex, triangle = blend_map(domain.vertices, domain.triangles, firm, problem.blend_mm)
    return Firmness(torch.from_numpy(triangle), torch.from_numpy(vertex[domain.weld]))


def segment_by_energy(problem: Problem) -> Bool[Array, " triangle"]:
    """Firm where the skin hardly deforms, soft where it must follow the motion (paper, Sec. 3.3.2).

    The energy is taken for one modulus everywhere. With the moduli of the present field it would feed back:
    the firm microstructure stores more energy for being firm, and would be called soft.
    """
    domain = problem.domain
    energy, areas = problem.unit_energy.numpy(), problem.areas.numpy()
    return segment(energy, areas, domain.triangles, domain.vertices, problem.segmentation)


def level_for_volume(problem: Problem, firm: Firmness, theta: Float[Tensor, "*layer"]) -> float:
    """Level at which the field has the target volume.

    Raises:
        SolverError: No level gives that volume, the limits of casting included.
    """
    low, high = width_limits(problem, problem.triangles, firm.triangles)

    def fraction(share: Float[Tensor, " triangle"]) -> Float[Tensor, ""]:
        volume = material_of(problem, low + (high - low) * share, firm.triangles).volume
        return (volume * problem.areas).sum() / problem.areas.sum()

    logits = problem.triangles.field.logits(theta, CONTRAST)
    return float(project_to_volume(logits, fraction, problem.settings.volume_fraction)[1])


def learning_rate(settings_rate: float, iteration: int, iterations: int) -> float:
    """Step of an iteration: a cosine from the full step to `LAST_STEP` of it."""
    share = iteration / max(1, iterations - 1)
    return settings_rate * (LAST_STEP + (1.0 - LAST_STEP) * 0.5 * (1.0 + math.cos(math.pi * share)))


def _step(problem: Problem, firm: Firmness, state: Progress, solvers: SolverPool | None) -> Progress:
    settings = problem.settings
    theta, bias = (tensor.requires_grad_() for tensor in _tensors(state))
    evaluation = evaluate(problem, firm, theta, bias, solvers)
    if state.iteration == 0:
        state = replace(state, **_start(problem, evaluation, solvers))
    row, total = _normalised(problem, evaluation, state)
    if not torch.isfinite(total):
        raise SolverError(
            f"the losses are not finite: {[float(f'{value:.3g}') for value in row]}",
            where=f"iteration {state.iteration}",
            hint="lower optimize.learning_rate, or check the forces and the mesh of the stages before",
        )
    gradient = torch.cat([part.ravel() for part in torch.autograd.grad(total, (theta, bias))])
    gradient = gradient * min(1.0, STEP_LIMIT / max(float(gradient.norm()), 1e-300))
    rate = learning_rate(settings.learning_rate, state.iteration, settings.iterations)
    moved, momentum = adam(_flat(state), gradient.numpy(), state.momentum, state.iteration + 1, rate)
    return replace(
        state,
        iteration=state.iteration + 1,
        theta=moved[:-1].reshape(state.theta.shape),
        bias=moved[-1:].reshape(()),
        momentum=momentum,
        history=np.concatenate([state.history, row.detach().numpy()[None]]),
    )


def adam(
    parameters: Float[Array, " parameter"],
    gradient: Float[Array, " parameter"],
    momentum: Float[Array, "2 parameter"],
    count: int,
    rate: float,
) -> tuple[Float[Array, " parameter"], Float[Array, "2 parameter"]]:
    """One step of Adam (Kingma & Ba 2015) as a function of its whole state.

    Args:
        parameters: Where to step from.
        gradient: Gradient there.
        momentum: First and second moment so far.
        count: Number of this step, from one.
        rate: Length of the step.

    Returns:
        The new parameters and moments.
    """
    first = 0.9 * momentum[0] + 0.1 * gradient
    second = 0.999 * momentum[1] + 0.001 * gradient**2
    direction = (first / (1 - 0.9**count)) / (np.sqrt(second / (1 - 0.999**count)) + 1e-8)
    return parameters - rate * direction, np.stack([first, second])


def _start(problem: Problem, evaluation: Evaluation, solvers: SolverPool | None) -> dict[str, Any]:
    taken = reference(problem, evaluation, solvers)
    return {
        "losses_initial": evaluation.terms.detach().numpy(),
        "measure": taken.start,
        "uniform": np.array([taken.preserved, taken.relieved]),
        "support": taken.support,
    }


def measure_of(state: Progress) -> Reference:
    """What the losses of a begun loop are measured by."""
    preserved, relieved = map(float, state.uniform)
    return Reference(state.measure, preserved, relieved, state.support)


def _normalised(
    problem: Problem, evaluation: Evaluation, state: Progress
) -> tuple[Float[Tensor, "6"], Float[Tensor, ""]]:
    """The row of the history (L1..L5 and total), and the total to minimise."""
    weights = torch.tensor(list(problem.settings.weights.model_dump().values()), dtype=torch.float64)
    terms = normalised(evaluation, measure_of(state), problem.settings.coupling)
    total = (weights * terms).sum()
    return torch.cat([terms, total[None]]), total


def _resume(checkpoint: Path, key: str) -> Progress | None:
    """The checkpoint's state, if it is whole and belongs to this stage."""
    if not checkpoint.exists():
        return None
    try:
        state = load(Progress, checkpoint)
    except InputError:
        return None
    return state if state.key == key else None


def _tensors(state: Progress) -> tuple[Tensor, Tensor]:
    return torch.from_numpy(state.theta.copy()), torch.from_numpy(np.array(state.bias))


def _flat(state: Progress) -> Float[Array, " parameter"]:
    return np.append(state.theta.ravel(), state.bias)
