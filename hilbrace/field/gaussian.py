"""The neural field of the design: one layer of Gaussian neurons over the flat map.

The paper (Sec. 6, Eq. 7) writes the field as ``sum_i w_i psi_i(u, v)`` with
``psi_i = exp(-sigma^2 ((u - u_i)^2 + (v - v_i)^2))``, 100 x 100 centres on the unit square and
``sum_i w_i = 1`` (after Qian et al. 2023). A Gaussian is a product of one factor in u and one in v, and a row
of 100 wide Gaussians spans far fewer than 100 directions; so the field is evaluated through the few singular
directions that double precision can tell from zero, which changes nothing but the time.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float

from hilbrace.errors import GeometryError

Array = np.ndarray

_MARGIN = 0.01
"""How far points may leave the unit square [uv units]."""

_ROUNDING = 1e-15
_SAMPLES_PER_NEURON = 6
_REACH = 6.5
"""``exp(-6.5^2)`` is below the rounding of a sum of Gaussians."""


class GaussianField:
    """A layer of Gaussian neurons, prepared for one set of points.

    Every set of points that is given the same parameters sees the same field.

    Args:
        points_uv: Points of the flat map, in the unit square.
        sigma: Sharpness of the neurons (paper: 4); the half width of one is about ``0.83 / sigma``.
        size: Neurons along each axis.
        period_u: Width of the map around the limb [uv units] where the field must close on itself; the
            centres then share one period. 0 for a map that is cut.

    Attributes:
        neuron_sum: Sum of all neurons at the middle of the map [-]: what `evaluate` gives there for weights
            of one. It makes fields of different sigma and size comparable.

    Raises:
        GeometryError: A point lies outside the unit square.
    """

    def __init__(
        self,
        points_uv: Float[Array, "point 2"],
        sigma: float,
        size: int = 100,
        period_u: float = 0.0,
    ) -> None:
        points = np.asarray(points_uv, dtype=np.float64)
        _check_points(points, period_u)
        self.sigma = sigma
        self.size = size
        self.period_u = period_u
        self._at_u, self._span_u, sum_u = _axis(points[:, 0], sigma, size, period_u)
        self._at_v, self._span_v, sum_v = _axis(points[:, 1], sigma, size, 0.0)
        self.neuron_sum = sum_u * sum_v

    def evaluate(self, theta: Float[torch.Tensor, "size size"]) -> Float[torch.Tensor, " point"]:
        """The field ``sum_i w_i psi_i`` at the points, before any projection.

        Args:
            theta: Free parameters; rows run along u, columns along v. See `hyperplane_weights`.
        """
        weights = hyperplane_weights(theta)
        core = self._span_u @ weights @ self._span_v.T
        return ((self._at_u @ core) * self._at_v).sum(dim=1)

    def logits(
        self, theta: Float[torch.Tensor, "size size"], contrast: float = 10.0
    ) -> Float[torch.Tensor, " point"]:
        """The field in the units of a sigmoid's argument: ``contrast * evaluate(theta) / neuron_sum``.

        Parameters that agree over a neighbourhood as wide as a neuron then move the logit by ``contrast``
        per unit, whatever sigma and size are.
        """
        return self.evaluate(theta) * (contrast / self.neuron_sum)


def hyperplane_weights(theta: Float[torch.Tensor, "size size"]) -> Float[torch.Tensor, "size size"]:
    """Weights on the hyperplane ``sum w = 1``: ``w_i = 1/N + theta_i - mean(theta)``."""
    return theta - theta.mean() + 1.0 / theta.numel()


def initial_parameters(
    size: int = 100, seed: int = 0, spread: float = 0.0
) -> Float[torch.Tensor, "size size"]:
    """Parameters to start from: zeros, equal weights, plus seeded normal noise of the given spread."""
    noise = np.random.default_rng(seed).standard_normal((size, size))
    return torch.from_numpy(spread * noise)


def neuron_row(
    coordinate: Float[Array, " point"], sigma: float, size: int, period: float
) -> Float[Array, "point size"]:
    """One-dimensional factors of the neurons at coordinates along one axis.

    Args:
        coordinate: Coordinates [uv units].
        sigma: Sharpness.
        size: Number of centres: on [0, 1] with both ends, or on one period without its end.
        period: Period [uv units]; 0 for an axis that does not close. The images of each neuron are summed.
    """
    if period == 0.0:
        return np.exp(-((sigma * (coordinate[:, None] - np.linspace(0.0, 1.0, size))) ** 2))
    offset = coordinate[:, None] - np.arange(size) * (period / size)
    offset -= period * np.round(offset / period)
    images = math.ceil(_REACH / (sigma * period))
    row = np.zeros_like(offset)
    for image in range(-images, images + 1):
        row += np.exp(-((sigma * (offset + image * period)) ** 2))
    return row


def _axis(
    coordinate: Float[Array, " point"], sigma: float, size: int, period: float
) -> tuple[Float[torch.Tensor, "point rank"], Float[torch.Tensor, "rank size"], float]:
    """Factors at the points in the span of the row of neurons, that span, and the row's sum in the middle."""
    low, high = (0.0, period) if period else (-_MARGIN, 1.0 + _MARGIN)
    samples = np.linspace(low, high, _SAMPLES_PER_NEURON * size)
    _, strength, directions = np.linalg.svd(neuron_row(samples, sigma, size, period), full_matrices=False)
    span = directions[strength > _ROUNDING * strength[0]]
    middle = neuron_row(np.array([0.5 * (low + high)]), sigma, size, period).sum()
    at_points = neuron_row(coordinate, sigma, size, period) @ span.T
    return torch.from_numpy(at_points), torch.from_numpy(np.ascontiguousarray(span)), float(middle)


def _check_points(points: Float[Array, "point 2"], period_u: float) -> None:
    bounded = points[:, 1:] if period_u else points
    inside = ((bounded >= -_MARGIN) & (bounded <= 1.0 + _MARGIN)).all(axis=1) & np.isfinite(points).all(
        axis=1
    )
    outside = np.flatnonzero(~inside)
    if outside.size:
        raise GeometryError(
            f"{outside.size} points lie outside the unit square of the flat map",
            where=f"point {outside[0]} at (u, v) = ({points[outside[0], 0]:g}, {points[outside[0], 1]:g})",
            hint="scale the flat map into [0, 1] x [0, 1]",
        )
