"""The neural field of the design: one layer of Gaussian neurons over the flat map.

The paper (Sec. 6, Eq. 7) writes the field as ``sum_i w_i psi_i(u, v)`` with
``psi_i = exp(-sigma^2 ((u - u_i)^2 + (v - v_i)^2))``, 100 x 100 centres on the unit square and
``sum_i w_i = 1`` (after Qian et al. 2023). A Gaussian is a product of one factor in u and one in v, and a row
of 100 wide Gaussians spans far fewer than 100 directions. So the sum is taken in low-rank form on a grid that
is fine against the Gaussians, through the few singular directions that double precision can tell from zero,
and sampled from there (`hilbrace.field.sampling`). Ten digits of the sum remain, whatever sigma is, and the
time does not grow with it.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float

from hilbrace.errors import GeometryError
from hilbrace.field.sampling import GridAxis, Sampler, grid_axis

Array = np.ndarray

_MARGIN = 0.01
"""How far points may leave the unit square [uv units]."""

_ROUNDING = 1e-15
_NODES = 12.0
"""Nodes of the grid over ``1 / sigma``: tenth-order interpolation of the Gaussian is then right to 1e-10."""
_REACH = 6.5
"""``exp(-6.5^2)`` is below the rounding of a sum of Gaussians."""


class GaussianField:
    """A layer of Gaussian neurons, prepared for one set of points; a `hilbrace.field.protocol.Field`.

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
        rank: Directions that the neurons span along u and along v.

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
        check_points(points, period_u)
        self.sigma = sigma
        self.size = size
        self.period_u = period_u
        ends = (0.0, period_u) if period_u else (-_MARGIN, 1.0 + _MARGIN)
        along_u = grid_axis(*ends, 1.0 / (_NODES * sigma), closed=period_u > 0.0)
        along_v = grid_axis(-_MARGIN, 1.0 + _MARGIN, 1.0 / (_NODES * sigma), closed=False)
        self._on_u, self._span_u, sum_u = _low_rank(along_u, sigma, size, period_u)
        self._on_v, self._span_v, sum_v = _low_rank(along_v, sigma, size, 0.0)
        self._sample = Sampler(points, along_u, along_v)
        self.neuron_sum = sum_u * sum_v
        self.rank = self._on_u.shape[1], self._on_v.shape[1]

    def start(self, seed: int, spread: float) -> Float[torch.Tensor, "size size"]:
        """Parameters to start from, see `initial_parameters`, the same from left to right and back.

        Braces of mirrored limbs then start, and end, as mirror images.
        """
        drawn = initial_parameters(self.size, seed, spread)
        return (drawn + self.mirrored(drawn)) * math.sqrt(0.5)

    def mirrored(self, theta: Float[torch.Tensor, "size size"]) -> Float[torch.Tensor, "size size"]:
        """Parameters of the field that is mirrored along u, about the middle of the map."""
        turned = theta.flip(0)
        return turned.roll(1, 0) if self.period_u else turned

    def evaluate(self, theta: Float[torch.Tensor, "size size"]) -> Float[torch.Tensor, " point"]:
        """The field ``sum_i w_i psi_i`` at the points, before any projection.

        Args:
            theta: Free parameters; rows run along u, columns along v. See `hyperplane_weights`.
        """
        weights = hyperplane_weights(theta)
        core = self._span_u @ weights @ self._span_v.T
        return self._sample(self._on_u @ core @ self._on_v.T)

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


def check_points(points: Float[Array, "point 2"], period_u: float) -> None:
    """Points of a flat map lie in the unit square; along a period they may lie anywhere.

    Args:
        points: Points of the map.
        period_u: Width of the map around the limb [uv units]; 0 for a map that is cut.

    Raises:
        GeometryError: Names the first point that does not.
    """
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


def _low_rank(
    axis: GridAxis, sigma: float, size: int, period: float
) -> tuple[Float[torch.Tensor, "node rank"], Float[torch.Tensor, "rank size"], float]:
    """Factors at the nodes in the span of the row of neurons, that span, and the row's sum in the middle."""
    rows = neuron_row(axis.nodes, sigma, size, period)
    left, strength, directions = np.linalg.svd(rows, full_matrices=False)
    kept = strength > _ROUNDING * strength[0]
    on_nodes = np.ascontiguousarray(left[:, kept] * strength[kept])
    middle = np.array([0.5 * period if period else 0.5])
    total = float(neuron_row(middle, sigma, size, period).sum())
    return torch.from_numpy(on_nodes), torch.from_numpy(np.ascontiguousarray(directions[kept])), total
