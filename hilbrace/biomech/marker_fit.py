"""Fit a jointed model to markers: inverse kinematics as weighted least squares.

The fit moves the whole model at once, joints intact, onto all markers of a frame (Lu & O'Connor, "Bone
position estimation from skin marker co-ordinates using global optimisation with joint constraints",
J. Biomech. 32, 1999), by Levenberg-Marquardt steps with the Jacobian of the multibody code. The model itself
stands behind two functions of a `Problem`, so that nothing here depends on who moves it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import solve_triangular

from hilbrace.errors import SolverError

Array = np.ndarray
Variables = Float[Array, " variable"]
"""Values of all coordinates, coupled ones included, in the order of the multibody code [rad or m]."""

STEP_TOLERANCE = 1e-7
"""Largest change of a coordinate [rad or m] at which a pose counts as found."""
LONGEST_STEP = 0.3
"""Largest change of a coordinate in one step [rad or m], so that no limb swings over into another minimum."""
MAX_STEPS = 300
SHARED_WEIGHT_M2 = 1e-5
"""Stiffness [m^2] that holds every free coordinate near its start: as much as one marker of weight 1 at 3 mm.

It decides only where the markers do not (a forearm with one marker); angles of a leg move by a few hundredths
of a degree.
"""


class Carriers(NamedTuple):
    """The bodies that carry the markers, in one pose; a body stands once for each of its markers.

    Attributes:
        rotations: From the body to the ground.
        origins: Origin of the body in the ground [m].
        velocities: Angular velocity and velocity of the origin per unit speed of each coordinate.
    """

    rotations: Float[Array, "marker 3 3"]
    origins: Float[Array, "marker 3"]
    velocities: Float[Array, "marker 2 3 variable"]


class Problem(NamedTuple):
    """What stays the same over the frames of a fit.

    Attributes:
        carriers: The marker-carrying bodies in the pose of some coordinates.
        couple: Sets the coordinates that depend on others, in place.
        locations: Place of each marker in its body [m].
        weights: Weight of each marker [-].
        free: Columns of the coordinates that are sought.
        stiffness: Stiffness that holds each of them near ``rest`` [m^2].
        rest: Start of the search and centre of the hold.
    """

    carriers: Callable[[Variables], Carriers]
    couple: Callable[[Variables], None]
    locations: Float[Array, "marker 3"]
    weights: Float[Array, " marker"]
    free: Int[Array, " free"]
    stiffness: Float[Array, " free"]
    rest: Variables


class Linearised(NamedTuple):
    """The cost of a fit about a pose.

    Attributes:
        cost: Weighted sum of squares [m^2].
        descent: Half its negative gradient.
        information: Half its second derivative for straight paths of the markers (Gauss-Newton).
        curvature: What the curvature of their paths adds to it.
        difference: Measured less model marker [m].
    """

    cost: float
    descent: Float[Array, " free"]
    information: Float[Array, "free free"]
    curvature: Float[Array, "free free"]
    difference: Float[Array, "marker 3"]


def fit_frame(
    problem: Problem, points: Float[Array, "marker 3"], q: Variables, frame: int
) -> tuple[Variables, Float[Array, " marker"], Float[Array, " free"]]:
    """Find the pose of one frame by Newton steps, damped where a step is no gain (Levenberg-Marquardt).

    Args:
        problem: The model and its markers.
        points: Measured markers [m]; NaN where hidden.
        q: Pose at which the search starts.
        frame: Number of the frame from 0, for the error.

    Returns:
        The pose, the distance of each marker [m] with NaN where hidden, and the support of each free
        coordinate [m^2]: stiffness that the visible markers give it when all others are free.

    Raises:
        SolverError: The search does not converge.
    """
    seen = np.array(np.isfinite(points).all(axis=1))
    weights = np.where(seen, problem.weights, 0.0)
    targets = np.where(seen[:, None], points, 0.0)
    damping, unit = 1e-6, np.eye(len(problem.free))
    now = linearise(problem, targets, weights, q)
    for _ in range(MAX_STEPS):
        step = _step(now, damping * unit)
        trial = q.copy()
        trial[problem.free] += step
        problem.couple(trial)
        after = linearise(problem, targets, weights, trial)
        found = np.abs(step).max() < STEP_TOLERANCE
        if found or after.cost <= now.cost:
            q, now, damping = trial, after, max(damping / 8.0, 1e-10)
        else:
            damping *= 8.0
        if found:
            distance = np.where(seen, np.linalg.norm(now.difference, axis=1), np.nan)
            support = 1.0 / np.diag(np.linalg.inv(now.information)) - problem.stiffness
            return q, distance, np.maximum(support, 0.0)
    raise SolverError(
        "the model cannot be brought onto the markers",
        where=f"frame {frame + 1}",
        hint="look for swapped or mislabelled markers there, or leave the frame out with motion.window",
    )


def linearise(
    problem: Problem, targets: Float[Array, "marker 3"], weights: Float[Array, " marker"], q: Variables
) -> Linearised:
    """The fit's cost at a pose, with its derivatives by the free coordinates.

    Args:
        problem: The model and its markers.
        targets: Where the markers shall be [m].
        weights: Weight of each marker in this frame [-]; zero for a hidden one.
        q: The pose.
    """
    rotations, origins, velocities = problem.carriers(q)
    arms = np.einsum("mij,mj->mi", rotations, problem.locations)
    difference = targets - origins - arms
    turn, shift = np.moveaxis(velocities[..., problem.free], 1, 0)
    slopes = shift + np.cross(turn, arms[:, :, None], axis=1)
    pull = weights[:, None] * difference
    flat = slopes.reshape(-1, slopes.shape[-1])
    away = (q - problem.rest)[problem.free]
    return Linearised(
        cost=float((pull * difference).sum() + problem.stiffness @ away**2),
        descent=flat.T @ pull.ravel() - problem.stiffness * away,
        information=(flat * np.repeat(weights, 3)[:, None]).T @ flat + np.diag(problem.stiffness),
        curvature=_curvature(turn, slopes, pull),
        difference=difference,
    )


def _step(at: Linearised, damping: Float[Array, "free free"]) -> Float[Array, " free"]:
    """Newton's step where the cost is convex, Gauss-Newton's elsewhere; never longer than `LONGEST_STEP`."""
    try:
        factor = np.linalg.cholesky(at.information + at.curvature + damping)
    except np.linalg.LinAlgError:
        factor = np.linalg.cholesky(at.information + damping)
    step = solve_triangular(factor.T, solve_triangular(factor, at.descent, lower=True))
    return step * min(1.0, LONGEST_STEP / max(float(np.abs(step).max()), LONGEST_STEP))


def _curvature(
    turn: Float[Array, "marker 3 free"], slopes: Float[Array, "marker 3 free"], pull: Float[Array, "marker 3"]
) -> Float[Array, "free free"]:
    """Half the second derivative of a fit's cost that stems from markers moving on arcs.

    When coordinate i turns a body, it turns the slopes of all coordinates j further out: d2x / dq_i dq_j =
    w_i x s_j. Coordinates come in the order of the multibody tree, inner ones first. Without this term the
    steps overshoot wherever markers stay far from the model. Translations are not turned by their own
    joint; those that splines couple to knee flexion are left out of the curvature.

    Args:
        turn: Angular velocity of each marker's body per unit speed.
        slopes: Velocity of each marker per unit speed [m].
        pull: Weight times measured less model marker [m].
    """
    turned = np.where(np.abs(turn).max(axis=1, keepdims=True) > 0.0, slopes, 0.0)
    inner = np.einsum("mci,mcj->ij", turn, np.cross(turned, pull[:, :, None], axis=1))
    upper = np.triu(inner)
    return -(upper + np.triu(inner, 1).T)
