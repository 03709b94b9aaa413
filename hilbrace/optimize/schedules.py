"""What changes with the iterations: the step, the worst-frame exponent, the projection's slope, the end."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from hilbrace.config import OptimizeSettings
from hilbrace.optimize.problem import Problem

Array = np.ndarray

LEAST_FALL = 1e-3
"""Fall of the total loss, over the size of its first value, that patience waits for [-]."""


def learning_rate(settings: OptimizeSettings, iteration: int) -> float:
    """Step of an iteration: a cosine from the full step to ``learning_rate_end`` of it.

    Args:
        settings: The optimizer's settings.
        iteration: Iterations done.
    """
    last = settings.learning_rate_end
    course = 0.5 * (1.0 + math.cos(math.pi * share_done(settings, iteration)))
    return settings.learning_rate * (last + (1.0 - last) * course)


def share_done(settings: OptimizeSettings, iteration: int) -> float:
    """How far an iteration is between the first (0) and the last one (1)."""
    return min(1.0, iteration / max(1, settings.iterations - 1))


def at_iteration(problem: Problem, iteration: int) -> Problem:
    """The design task as an iteration sees it: exponent of the worst frame and slope of the projection.

    Both rise evenly in logarithms, from ``p_norm_start`` and 1 to ``p_norm`` and ``sharpness_end``.

    Args:
        problem: The design task.
        iteration: Iterations done.
    """
    settings, share = problem.settings, share_done(problem.settings, iteration)
    exponent = settings.p_norm
    if settings.p_norm_start is not None:
        exponent = settings.p_norm_start ** (1.0 - share) * settings.p_norm**share
    if exponent == settings.p_norm and settings.sharpness_end == 1.0:
        return problem
    return replace(
        problem,
        settings=settings.model_copy(update={"p_norm": exponent}),
        sharpness=settings.sharpness_end**share,
    )


def is_done(settings: OptimizeSettings, totals: Float[Array, " iteration"]) -> bool:
    """Whether the loop has run out of iterations, or of patience.

    Args:
        settings: The optimizer's settings.
        totals: Total loss of every iteration so far.
    """
    if len(totals) >= settings.iterations:
        return True
    if not 0 < settings.patience < len(totals):
        return False
    before, lately = totals[: -settings.patience].min(), totals[-settings.patience :].min()
    return bool(before - lately < LEAST_FALL * abs(totals[0]))


def is_snapshot(settings: OptimizeSettings, iteration: int) -> bool:
    """Whether the field at the start of an iteration belongs into the film.

    Args:
        settings: The optimizer's settings.
        iteration: Iterations done.
    """
    if settings.snapshots < 1:
        return False
    every = max(1, math.ceil(settings.iterations / settings.snapshots))
    return iteration % every == 0
