"""The design loop: Adam on the field's parameters, with checkpoints that a killed run goes on from.

All that the loop carries from one iteration to the next is in `hilbrace.optimize.state.Progress`; it is saved
and read back bit for bit, so that an interrupted run ends in the same design as an undisturbed one.

The volume is kept by the loss L4 (``penalised``), or exactly: then the level of the field is solved for in
every iteration, and the gradient follows it by the implicit function theorem.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.errors import SolverError
from hilbrace.field import project_to_volume
from hilbrace.optimize.brace_response import posture_stiffness
from hilbrace.optimize.coupling import brace_spring
from hilbrace.optimize.design import LOSSES
from hilbrace.optimize.evaluate import (
    CONTRAST,
    Evaluation,
    Firmness,
    design_variable,
    evaluate,
    fraction_of,
    material_of,
)
from hilbrace.optimize.firm_map import firmness, segment_by_energy
from hilbrace.optimize.history import TRACE, Snapshot, Watch
from hilbrace.optimize.objective import normalised, reference
from hilbrace.optimize.problem import Problem, width_limits
from hilbrace.optimize.schedules import at_iteration, is_done, is_snapshot, learning_rate, share_done
from hilbrace.optimize.state import Progress, drawn, first_generator, measure_of, quantised, resumed
from hilbrace.optimize.uniform import uniform_design
from hilbrace.run.progress import Report
from hilbrace.run.records import save
from hilbrace.shell import SolverPool
from hilbrace.units import DEG

Array = np.ndarray

START_NOISE = 0.02
"""Standard deviation of the first field [-]."""


@dataclass(frozen=True)
class Outcome:
    """What a loop ends with.

    Attributes:
        state: The last state; its history and trace have a last row for the finished field.
        firm: The firm and soft map.
        evaluation: Losses of the finished field.
        problem: The design task as the last iteration saw it.
        seconds: Median time of an iteration [s]; 0 if none was left to do.
    """

    state: Progress
    firm: Firmness
    evaluation: Evaluation
    problem: Problem
    seconds: float


def run_loop(
    problem: Problem,
    checkpoint: Path,
    key: str,
    report: Report,
    solvers: SolverPool | None = None,
    watches: Sequence[Watch] = (),
) -> Outcome:
    """Optimize, going on from a checkpoint of the same stage if there is one.

    Args:
        problem: The design task.
        checkpoint: File for the checkpoints.
        key: Key of the stage.
        report: Called with (iterations done, iterations in all).
        solvers: Open solvers of the shell's sparsity; own ones for every iteration if left out.
        watches: Called with a snapshot after every iteration.

    Raises:
        SolverError: A loss is not finite, or no level gives the volume that is to be kept exactly.
    """
    settings = problem.settings
    state = resumed(checkpoint, key) or first_state(problem, key)
    firm = firmness(problem, state.firm)
    seconds: list[float] = []
    while not is_done(settings, state.history[:, -1]):
        start = time.perf_counter()
        if _is_refresh(problem, state.iteration):
            state = _segmented(problem, firm, state)
            firm = firmness(problem, state.firm)
        state, d = _step(problem, firm, state, solvers)
        seconds.append(time.perf_counter() - start)
        if state.iteration % settings.checkpoint_every == 0:
            save(state, checkpoint)
        report(state.iteration, settings.iterations)
        left = float(np.median(seconds)) * (settings.iterations - state.iteration)
        for watch in watches:
            watch(_snapshot(problem, state, d, left))
    return _closed(problem, firm, state, seconds, solvers)


def first_state(problem: Problem, key: str) -> Progress:
    """The first field: uniform at the target volume, but for a trace of noise from the seed."""
    settings = problem.settings
    theta = problem.triangles.field.start(settings.seed, START_NOISE)
    firm = segment_by_energy(problem)
    bias = float(level_for_volume(problem, firmness(problem, firm), theta))
    return Progress(
        key=key,
        iteration=0,
        theta=theta.numpy(),
        bias=np.array(bias),
        momentum=np.zeros((2, theta.numel() + 1)),
        generator=first_generator(settings.seed),
        firm=firm,
        history=np.zeros((0, len(LOSSES) + 1)),
        trace=np.zeros((0, len(TRACE))),
        film=np.zeros((0, len(problem.domain.uv)), dtype=np.uint8),
        film_iterations=np.zeros(0, dtype=np.int64),
        losses_initial=np.zeros(5),
        measure=np.zeros(5),
        uniform=np.zeros(2),
        support=np.zeros((0, 0)),
        plain=np.zeros(3),
    )


def level_for_volume(problem: Problem, firm: Firmness, theta: Float[Tensor, "*layer"]) -> Float[Tensor, ""]:
    """Level at which the field has the target volume, with its implicit derivative.

    Raises:
        SolverError: No level gives that volume, the limits of casting included.
    """
    low, high = width_limits(problem, problem.triangles, firm.triangles)

    def fraction(share: Float[Tensor, " triangle"]) -> Float[Tensor, ""]:
        volume = material_of(problem, low + (high - low) * share, firm.triangles).volume
        return (volume * problem.areas).sum() / problem.areas.sum()

    logits = problem.triangles.field.logits(theta, CONTRAST)
    target = problem.settings.volume_fraction
    return project_to_volume(logits, fraction, target, problem.sharpness)[1]


def _step(
    problem: Problem, firm: Firmness, state: Progress, solvers: SolverPool | None
) -> tuple[Progress, Float[Array, " triangle"]]:
    """One iteration: the state after it, and the design variable before its step."""
    settings, now = problem.settings, at_iteration(problem, state.iteration)
    theta, bias = (tensor.requires_grad_() for tensor in state.tensors())
    level = level_for_volume(now, firm, theta) if settings.volume == "exact" else bias
    evaluation = evaluate(now, firm, theta, level, solvers)
    if state.iteration == 0:
        state = _begun(problem, evaluation, state, solvers)
    row, total = _normalised(problem, evaluation, state)
    if not torch.isfinite(total):
        raise SolverError(
            f"the losses are not finite: {[float(f'{value:.3g}') for value in row]}",
            where=f"iteration {state.iteration}",
            hint="lower optimize.learning_rate, or check the forces and the mesh of the stages before",
        )
    slopes = torch.autograd.grad(total, (theta, bias), materialize_grads=True)
    raw = torch.cat([part.ravel() for part in slopes]).numpy()
    gradient, generator = _disturbed(_limited(raw, settings.gradient_limit), problem, state)
    rate = learning_rate(settings, state.iteration)
    state = replace(state, bias=np.array(level.item()))
    traced = _traced(now, evaluation, state, float(np.linalg.norm(raw)), rate)
    state = _filmed(now, firm, state)
    moved, momentum = adam(state.flat(), gradient, state.momentum, state.iteration + 1, rate)
    state = replace(
        state,
        iteration=state.iteration + 1,
        theta=moved[:-1].reshape(state.theta.shape),
        bias=moved[-1:].reshape(()),
        momentum=momentum,
        generator=generator,
        history=np.concatenate([state.history, row.detach().numpy()[None]]),
        trace=np.concatenate([state.trace, traced[None]]),
    )
    return state, evaluation.material.d.detach().numpy()


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


def _limited(gradient: Float[Array, " parameter"], limit: float) -> Float[Array, " parameter"]:
    """The gradient, shortened to a largest norm; 0 is no limit."""
    if limit == 0.0:
        return gradient
    return gradient * min(1.0, limit / max(float(np.linalg.norm(gradient)), 1e-300))


def _disturbed(
    gradient: Float[Array, " parameter"], problem: Problem, state: Progress
) -> tuple[Float[Array, " parameter"], str]:
    """The gradient with noise that fades (Neelakantan et al. 2015), and the generator's state after it."""
    size = problem.settings.gradient_noise * (1.0 - share_done(problem.settings, state.iteration))
    if size == 0.0:
        return gradient, state.generator
    noise, generator = drawn(state.generator, gradient.size)
    return gradient + noise * (size * np.linalg.norm(gradient) / np.sqrt(gradient.size)), generator


def _begun(problem: Problem, evaluation: Evaluation, state: Progress, solvers: SolverPool | None) -> Progress:
    """The state with what all later losses and stiffnesses are measured by."""
    taken = reference(problem, evaluation, solvers)
    with torch.no_grad():
        plain = uniform_design(problem, problem.settings.volume_fraction)
        loops = posture_stiffness(problem, plain.modulus, solvers)
    return replace(
        state,
        losses_initial=evaluation.terms.detach().numpy(),
        measure=taken.start,
        uniform=np.array([taken.preserved, taken.relieved]),
        support=taken.support,
        plain=_at_rest(problem, loops),
    )


def _normalised(
    problem: Problem, evaluation: Evaluation, state: Progress
) -> tuple[Float[Tensor, "6"], Float[Tensor, ""]]:
    """The row of the history (L1..L5 and total), and the total to minimise."""
    weights = torch.tensor(list(problem.settings.weights.model_dump().values()), dtype=torch.float64)
    terms = normalised(evaluation, measure_of(state), problem.settings.coupling)
    total = (weights * terms).sum()
    return torch.cat([terms, total[None]]), total


def _is_refresh(problem: Problem, iteration: int) -> bool:
    every = problem.settings.segmentation_every
    return every > 0 and iteration > 0 and iteration % every == 0


def _segmented(problem: Problem, firm: Firmness, state: Progress) -> Progress:
    """The state with the segmentation by what the present brace stores over the motion."""
    with torch.no_grad():
        d = design_variable(
            at_iteration(problem, state.iteration), problem.triangles, firm.triangles, *state.tensors()
        )
        modulus = problem.cells.modulus(d, firm.triangles).numpy()
    return replace(state, firm=segment_by_energy(problem, modulus))


def _filmed(problem: Problem, firm: Firmness, state: Progress) -> Progress:
    """The state with a snapshot of its field, if one is due."""
    if not is_snapshot(problem.settings, state.iteration):
        return state
    with torch.no_grad():
        d = design_variable(problem, problem.vertices, firm.vertices, *state.tensors())
    return replace(
        state,
        film=np.concatenate([state.film, quantised(d.numpy())[None]]),
        film_iterations=np.append(state.film_iterations, state.iteration),
    )


def _traced(
    problem: Problem, evaluation: Evaluation, state: Progress, gradient: float, rate: float
) -> Float[Array, " column"]:
    """The row of the trace, columns as `TRACE`."""
    loops = evaluation.mechanics.response.loops.detach()
    sagittal, frontal, _ = _at_rest(problem, loops)
    ratio = (frontal / sagittal) / (state.plain[1] / state.plain[0])
    areas = problem.areas.numpy()
    firm = float((state.firm * areas).sum() / areas.sum())
    with torch.no_grad():
        fraction = fraction_of(problem, evaluation.material)
    schedule = (rate, problem.settings.p_norm, problem.sharpness)
    return np.array([fraction, frontal, sagittal, ratio, firm, float(state.bias), gradient, *schedule])


def _at_rest(problem: Problem, loops: Float[Tensor, "posture 12 12"]) -> Float[Array, "3"]:
    """Stiffness about the joint's three angles in the rest posture [N*m/deg]."""
    spring = brace_spring(problem, loops).stiffness[problem.rest_posture]
    return torch.diagonal(spring).numpy() * DEG


def _snapshot(problem: Problem, state: Progress, d: Float[Array, " triangle"], left: float) -> Snapshot:
    row = state.history[-1]
    return Snapshot(
        state.iteration, problem.settings.iterations, row[:-1], float(row[-1]), state.trace[-1], d, left
    )


def _closed(
    problem: Problem, firm: Firmness, state: Progress, seconds: list[float], solvers: SolverPool | None
) -> Outcome:
    """Evaluate the finished field."""
    now = at_iteration(problem, max(0, state.iteration - 1))
    with torch.no_grad():
        theta, bias = state.tensors()
        level = level_for_volume(now, firm, theta) if problem.settings.volume == "exact" else bias
        last = evaluate(now, firm, theta, level, solvers)
        row, _ = _normalised(problem, last, state)
    state = replace(state, bias=np.array(level.item()))
    traced = _traced(now, last, state, np.nan, np.nan)
    with torch.no_grad():
        d = design_variable(now, now.vertices, firm.vertices, *state.tensors())
    filmed = problem.settings.snapshots > 0
    state = replace(
        state,
        history=np.concatenate([state.history, row.numpy()[None]]),
        trace=np.concatenate([state.trace, traced[None]]),
        film=np.concatenate([state.film, quantised(d.numpy())[None]]) if filmed else state.film,
        film_iterations=np.append(state.film_iterations, state.iteration)
        if filmed
        else state.film_iterations,
    )
    return Outcome(state, firm, last, now, float(np.median(seconds)) if seconds else 0.0)
