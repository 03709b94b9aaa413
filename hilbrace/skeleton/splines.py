"""The functions that drive a joint's axes: linear, constant, and OpenSim's cubic ``SimmSpline``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from hilbrace.errors import InputError
from hilbrace.skeleton.table import Function

Array = np.ndarray


@runtime_checkable
class JointFunction(Protocol):
    """A smooth function of one coordinate."""

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Value at ``x``."""
        ...

    def slope(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """First derivative at ``x``."""
        ...


@dataclass(frozen=True)
class Linear:
    """a x + b."""

    a: float
    b: float

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Value at ``x``."""
        return self.a * np.asarray(x) + self.b

    def slope(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """First derivative at ``x``."""
        return np.full(np.shape(x), self.a)


@dataclass(frozen=True)
class SimmSpline:
    """Natural-looking cubic spline with the end conditions of Forsythe, Malcolm and Moler (1977).

    The third derivative at each end is that of the cubic through the four outermost points; outside the
    knots the function goes on along its tangent. Same values as OpenSim's ``SimmSpline``.

    Attributes:
        knots: Abscissae, increasing.
        coefficients: Value, slope, half the second and a sixth of the third derivative at the left end of
            each interval; a last row continues the spline linearly.
    """

    knots: Float[Array, " knot"]
    coefficients: Float[Array, "knot 4"]

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Value at ``x``."""
        (value, slope, half_second, sixth_third), step = self._interval(x)
        return value + step * (slope + step * (half_second + step * sixth_third))

    def slope(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """First derivative at ``x``."""
        (_, slope, half_second, sixth_third), step = self._interval(x)
        return slope + step * (2.0 * half_second + 3.0 * step * sixth_third)

    def _interval(self, x: Array) -> tuple[Array, Array]:
        x = np.asarray(x, dtype=float)
        index = np.searchsorted(self.knots, x, side="right") - 1
        before = index < 0
        index = np.maximum(index, 0)
        rows = np.moveaxis(self.coefficients[index], -1, 0)
        if before.any():
            rows[2:] = np.where(before, 0.0, rows[2:])
        return rows, x - self.knots[index]


def simm_spline(x: Sequence[float], y: Sequence[float]) -> SimmSpline:
    """Fit the spline through points.

    Args:
        x: Abscissae, strictly increasing, at least two.
        y: Ordinates, as many.

    Raises:
        InputError: Too few points, or abscissae that do not increase.
    """
    knots, values = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    count = len(knots)
    if count < 2 or len(values) != count or np.any(np.diff(knots) <= 0):
        raise InputError("no spline through these points", where=f"x = {list(x)}", hint="give x increasing")
    widths = np.diff(knots)
    secants = np.diff(values) / widths
    curvature = np.linalg.solve(*_curvature_system(knots, widths, secants)) if count > 2 else np.zeros(2)
    third = np.diff(curvature) / widths
    slopes = secants - widths * (curvature[1:] + 2.0 * curvature[:-1])
    inner = np.column_stack([values[:-1], slopes, 3.0 * curvature[:-1], third])
    last = widths[-1]
    end_slope = slopes[-1] + 6.0 * curvature[-2] * last + 3.0 * third[-1] * last**2
    return SimmSpline(knots, np.vstack([inner, [values[-1], end_slope, 0.0, 0.0]]))


def joint_function(figures: Function) -> JointFunction:
    """The function that a table entry describes.

    Raises:
        InputError: The entry names no known kind of function.
    """
    match figures:
        case {"constant": value}:
            return Linear(0.0, float(value))
        case {"linear": [a, b]}:
            return Linear(float(a), float(b))
        case {"spline": [x, y]}:
            return simm_spline(x, y)
    raise InputError("unknown joint function", where=str(figures), hint="use linear, constant or spline")


def _curvature_system(knots: Array, widths: Array, secants: Array) -> tuple[Array, Array]:
    """Equations for a sixth of the second derivative at the knots."""
    count = len(knots)
    matrix, right = np.zeros((count, count)), np.zeros(count)
    inner = np.arange(1, count - 1)
    matrix[inner, inner - 1] = widths[:-1]
    matrix[inner, inner] = 2.0 * (widths[:-1] + widths[1:])
    matrix[inner, inner + 1] = widths[1:]
    right[inner] = np.diff(secants)
    matrix[0, :2] = -widths[0], widths[0]
    matrix[-1, -2:] = widths[-1], -widths[-1]
    if count > 3:
        second = np.diff(secants) / (knots[2:] - knots[:-2])
        right[0] = widths[0] ** 2 * (second[1] - second[0]) / (knots[3] - knots[0])
        right[-1] = -(widths[-1] ** 2) * (second[-1] - second[-2]) / (knots[-1] - knots[-4])
    return matrix, right
