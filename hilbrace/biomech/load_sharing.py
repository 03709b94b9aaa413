"""Who carries how much: muscles share moments with ideal reserves and with the surfaces of the joints.

A convex quadratic programme per frame, solved for all frames at once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hilbrace.errors import SolverError

Array = np.ndarray

GAP = 1e-13
"""Mean product of a bound's distance and its multiplier at which a frame counts as solved [-]."""
SLOPE = 1e-9
"""Largest slope of the Lagrangian at that point, as a part of the slope at the start [-]."""
MAX_STEPS = 80
TO_BOUND = 0.995
"""Part of the way to the nearest bound that a step may go [-]."""


class Shares(NamedTuple):
    """How a demand is met.

    Attributes:
        activation: Activations, from the least to 1 [-].
        rest: What is left of each demand for its reserve or surface [unit of the row].
        steps: Newton steps taken.
    """

    activation: Float[Array, "frame muscle"]
    rest: Float[Array, "frame row"]
    steps: int


class _Point(NamedTuple):
    """Activations above their least, their distance to 1, and multipliers of both bounds."""

    above: Float[Array, "frame muscle"]
    room: Float[Array, "frame muscle"]
    low: Float[Array, "frame muscle"]
    high: Float[Array, "frame muscle"]


def share_load(
    effect: Float[Array, "frame row muscle"],
    demand: Float[Array, "frame row"],
    strength: Float[Array, " row"],
    least: Float[Array, " muscle"],
) -> Shares:
    """Least sum of squared activations, and of squared rests by the strengths of their rows.

    For every frame, minimise ``sum_m a_m^2 + sum_r (rest_r / strength_r)^2`` over ``least <= a <= 1`` with
    ``rest = demand - effect a``. A row is the moment about a coordinate with its reserve, whose strength is
    the reserve's optimal force (OpenSim's static optimisation with coordinate actuators is this programme),
    or the load on a joint surface, which takes what the muscles press on it.

    Primal-dual interior points with Mehrotra's predictor and corrector (Nocedal & Wright, Numerical
    Optimization, 2nd ed., alg. 16.4). Each step solves one system with one unknown per row, not per muscle.

    Args:
        effect: What each muscle adds to each row at full activation [unit of the row].
        demand: What each row demands [unit of the row].
        strength: Strength of each row's reserve or surface, positive [unit of the row].
        least: Least activation of each muscle, below 1 [-].

    Raises:
        SolverError: A frame does not converge, or the input is not finite.
    """
    if not (np.isfinite(effect).all() and np.isfinite(demand).all()):
        raise SolverError(
            "moments or muscle capacities are not finite",
            where="muscle forces",
            hint="look for gaps in forces or markers, or leave the frames out with motion.window",
        )
    rows, wanted = effect / strength[:, None], demand / strength
    above = np.zeros((effect.shape[0], effect.shape[2]))
    active, steps = np.arange(len(demand)), 0
    half = np.broadcast_to(0.5 * (1.0 - least), above.shape)
    start = np.abs(_slope(rows, wanted, least + half)).max(axis=1, initial=1.0)
    bounds = np.broadcast_to(start[:, None], above.shape)
    point = _Point(half, half, bounds, bounds)
    while len(active) and effect.shape[2]:
        slope = _slope(rows, wanted, least + point.above) - point.low + point.high
        gap = 0.5 * (point.above * point.low + point.room * point.high).mean(axis=1)
        done = (gap < GAP) & (np.abs(slope).max(axis=1) < SLOPE * start)
        above[active[done]] = point.above[done]
        keep = ~done
        active, rows, wanted, start = active[keep], rows[keep], wanted[keep], start[keep]
        point = _Point(*(part[keep] for part in point))
        if not len(active):
            break
        if steps == MAX_STEPS:
            raise SolverError(
                f"muscle forces do not converge in {len(active)} frames",
                where=f"muscle forces, frame {active[0] + 1}",
                hint="look for implausible moments there: swapped plates or markers",
            )
        point, steps = _advance(rows, point, slope[keep], gap[keep]), steps + 1
    activation = np.clip(least + above, least, 1.0)
    return Shares(activation, demand - np.einsum("frm,fm->fr", effect, activation), steps)


def _slope(
    rows: Float[Array, "frame row muscle"],
    wanted: Float[Array, "frame row"],
    a: Float[Array, "frame muscle"],
) -> Float[Array, "frame muscle"]:
    """Half the cost's gradient."""
    rest = wanted - np.matmul(rows, a[..., None])[..., 0]
    return a - np.matmul(rest[:, None], rows)[:, 0]


def _advance(
    rows: Float[Array, "frame row muscle"],
    point: _Point,
    slope: Float[Array, "frame muscle"],
    gap: Float[Array, " frame"],
) -> _Point:
    """One step: predict how far the bounds allow, then aim at the centre and correct for curvature."""
    above, room, low, high = point
    spring = 1.0 / (1.0 + low / above + high / room)
    soft = rows * spring[:, None]
    system = np.linalg.inv(np.matmul(soft, np.swapaxes(rows, 1, 2)) + np.eye(rows.shape[1]))

    def solve(off_low: Array, off_high: Array) -> _Point:
        """Newton's step; the offsets are what the products of distance and multiplier shall change by."""
        pull = spring * (-slope + off_low / above - off_high / room)
        inner = np.matmul(system, np.matmul(rows, pull[..., None]))
        step = pull - np.matmul(np.swapaxes(soft, 1, 2), inner)[..., 0]
        return _Point(step, -step, (off_low - low * step) / above, (off_high + high * step) / room)

    ahead = solve(-low * above, -high * room)
    reach = _reach(point, ahead)[:, None]
    after = (above + reach * ahead.above) * (low + reach * ahead.low)
    after = after + (room + reach * ahead.room) * (high + reach * ahead.high)
    centre = ((0.5 * after.mean(axis=1) / gap) ** 3 * gap)[:, None]
    step = solve(
        centre - low * above - ahead.above * ahead.low,
        centre - high * room - ahead.room * ahead.high,
    )
    reach = TO_BOUND * _reach(point, step)[:, None]
    return _Point(*(value + reach * change for value, change in zip(point, step, strict=True)))


def _reach(point: _Point, step: _Point) -> Float[Array, " frame"]:
    """Part of a step, at most 1, at which the first bound or multiplier is used up."""
    use = np.max(-np.concatenate(step, axis=1) / np.concatenate(point, axis=1), axis=1)
    return 1.0 / np.maximum(use, 1.0)
