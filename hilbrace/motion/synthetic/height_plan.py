"""The vertical force first: a centre-of-mass height whose ground force can exist.

The ground only pushes. The acceleration of the centre of mass is therefore a cubic B-spline whose
coefficients are at least -g everywhere, and exactly -g wherever their support touches the flight: flight is
ballistic, and the force leaves and returns with zero slope. Integrated twice, it gives the height.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.optimize import lsq_linear

from hilbrace.errors import SolverError
from hilbrace.motion.synthetic.curves import basis, clamped_knots
from hilbrace.units import GRAVITY

Array = np.ndarray

_DEGREE = 3
_CEILING = 60.0
_EXACT = 1e4
_GRID = 0.01


@dataclass(frozen=True)
class Waypoint:
    """Height [m] and, where given, vertical velocity [m/s] of the centre of mass at an instant [s]."""

    time: float
    height: float
    velocity: float | None = 0.0


@dataclass(frozen=True)
class AccelerationWish:
    """An upward acceleration [m/s^2] that is wished for at an instant [s], with its weight."""

    time: float
    acceleration: float
    weight: float


@dataclass(frozen=True)
class HeightPlan:
    """Planned vertical motion of the centre of mass.

    Attributes:
        start: First waypoint.
        spline: Acceleration [m/s^2] as a function of time [s].
    """

    start: Waypoint
    spline: BSpline

    def height(self, time: Float[Array, " frame"]) -> Float[Array, " frame"]:
        """Height [m] at each instant."""
        return self.start.height + self.spline.antiderivative(2)(time)

    def acceleration(self, time: Float[Array, " frame"]) -> Float[Array, " frame"]:
        """Upward acceleration [m/s^2] at each instant."""
        return self.spline(time)


def plan_height(
    waypoints: Sequence[Waypoint],
    flight: tuple[float, float] | None = None,
    wishes: Sequence[AccelerationWish] = (),
    knot_step: float = 0.025,
    smoothness: float = 3e-3,
) -> HeightPlan:
    """The smoothest vertical motion through the waypoints with a ground force that never pulls.

    Args:
        waypoints: Conditions in the order of time; the first and the last are at rest and bound the motion.
        flight: Instants of take-off and touch-down [s].
        wishes: Accelerations that shape peaks, met as far as the conditions allow.
        knot_step: Distance of the spline's knots [s].
        smoothness: Weight of the jerk.

    Returns:
        The plan; its impulse balance holds by construction.

    Raises:
        SolverError: The waypoints contradict each other or need a pull from the ground.
    """
    first, last = waypoints[0], waypoints[-1]
    knots = clamped_knots(first.time, last.time, knot_step, _DEGREE)
    shape = basis(knots, _DEGREE)
    heights, velocities, jerks = shape.antiderivative(2), shape.antiderivative(1), shape.derivative(1)
    rows: list[Array] = []
    values: list[float] = []
    for point in waypoints[1:]:
        rows.append(_EXACT * heights(point.time))
        values.append(_EXACT * (point.height - first.height))
        if point.velocity is not None:
            rows.append(_EXACT * velocities(point.time))
            values.append(_EXACT * point.velocity)
    conditions = len(rows)
    for wish in wishes:
        rows.append(wish.weight * shape(wish.time))
        values.append(wish.weight * wish.acceleration)
    grid = np.arange(first.time, last.time + 1e-9, _GRID)
    matrix = np.concatenate([np.array(rows), smoothness * jerks(grid)])
    target = np.concatenate([np.array(values), np.zeros(len(grid))])
    answer = lsq_linear(matrix, target, _bounds(knots, flight), method="bvls", max_iter=500)
    misfit = np.abs(matrix[:conditions] @ answer.x - target[:conditions]).max() / _EXACT
    if not answer.success or misfit > 1e-5:
        raise SolverError(
            f"the vertical motion misses a waypoint by {1000 * misfit:.3g} mm or mm/s",
            where="height plan of the synthetic motion",
            hint="give the motion more time, or less height between waypoints",
        )
    return HeightPlan(first, BSpline(knots, answer.x, _DEGREE))


def _bounds(knots: Float[Array, " knot"], flight: tuple[float, float] | None) -> tuple[Array, Array]:
    """Bounds on the coefficients: no pull, free fall in flight, rest at both ends."""
    count = len(knots) - _DEGREE - 1
    low, high = np.full(count, -GRAVITY), np.full(count, _CEILING)
    slack = 1e-9
    if flight is not None:
        begins, ends = knots[:count], knots[_DEGREE + 1 :]
        falls = (ends > flight[0] + slack) & (begins < flight[1] - slack)
        high[falls], low[falls] = -GRAVITY + slack, -GRAVITY - slack
    rest = np.r_[0:_DEGREE, count - _DEGREE : count]
    low[rest], high[rest] = -slack, slack
    return low, high
