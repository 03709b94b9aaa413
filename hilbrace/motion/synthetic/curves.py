"""Smooth curves of time from which the synthetic motions are made."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline, make_interp_spline

Array = np.ndarray


def ramp(time: Float[Array, " frame"], start: float, end: float) -> Float[Array, " frame"]:
    """Rise from 0 to 1 between two instants, with three continuous derivatives (septic smoothstep)."""
    s = np.clip((time - start) / (end - start), 0.0, 1.0)
    return s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


def pulse(
    time: Float[Array, " frame"], rise: float, top: float, fall: float, end: float
) -> Float[Array, " frame"]:
    """Rise from 0 to 1 between ``rise`` and ``top``, back to 0 between ``fall`` and ``end``."""
    return ramp(time, rise, top) - ramp(time, fall, end)


def hump(time: Float[Array, " frame"], start: float, end: float) -> Float[Array, " frame"]:
    """A symmetric hump of height 1 between two instants, with three continuous derivatives."""
    s = np.clip((time - start) / (end - start), 0.0, 1.0)
    return (4 * s * (1 - s)) ** 4


def glide(
    time: Float[Array, " frame"], start: float, end: float, leaving: float, arriving: float
) -> Float[Array, " frame"]:
    """Travel from 0 to 1 at constant speed but for a smooth start and stop, with continuous acceleration.

    Args:
        time: Instants [s].
        start: Instant of departure [s].
        end: Instant of arrival [s].
        leaving: Share of the travel time spent in gaining speed.
        arriving: Share of the travel time spent in losing it.

    Returns:
        Distance travelled.
    """
    s = np.clip((time - start) / (end - start), 0.0, 1.0)
    gained = leaving * _gained(s / leaving)
    lost = arriving * _gained((s - 1 + arriving) / arriving)
    return (gained - lost) / (1 - (leaving + arriving) / 2)


def clamped_knots(
    start: float,
    end: float,
    step: float,
    degree: int,
    fine: tuple[float, float, float] | None = None,
) -> Float[Array, " knot"]:
    """Knots of a B-spline between two instants.

    Args:
        start: First instant [s].
        end: Last instant [s].
        step: Distance of the knots, rounded so that they fit [s].
        degree: Degree of the spline; the end knots are repeated as often.
        fine: Interval and knot distance inside it [s] where the spline must follow faster changes.
    """
    count = max(int(np.ceil((end - start) / step - 1e-9)), degree + 1)
    knots = np.linspace(start, end, count + 1)
    if fine is not None:
        low, high, inner = fine
        outside = knots[(knots < low - inner / 2) | (knots > high + inner / 2)]
        knots = np.sort(np.concatenate([outside, np.arange(low, high + 1e-9, inner)]))
    return np.concatenate([[start] * degree, knots, [end] * degree])


def basis(knots: Float[Array, " knot"], degree: int) -> BSpline:
    """All B-spline basis functions of a knot vector as one vector-valued spline."""
    return BSpline(knots, np.eye(len(knots) - degree - 1), degree)


def time_derivative(time: Float[Array, " frame"]) -> Float[Array, "frame frame"]:
    """Matrix that differentiates samples at ``time`` by quintic spline interpolation [1/s]."""
    spline = make_interp_spline(time, np.eye(len(time)), k=5)
    return spline.derivative()(time)


def _gained(s: Float[Array, " frame"]) -> Float[Array, " frame"]:
    """Integral of the cubic smoothstep from 0; it grows like ``s - 1/2`` beyond 1."""
    inside = np.clip(s, 0.0, 1.0)
    return inside**3 * (1 - inside / 2) + np.maximum(s - 1, 0.0)
