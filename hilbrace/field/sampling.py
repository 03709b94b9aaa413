"""A smooth function of the flat map, known on a fine even grid, at any points of the map.

Between the nodes it is the polynomial through the `STENCIL` nearest of them along each axis. With nodes a
fixed fraction of the function's own length apart the polynomial is the function to ten digits, so that a sum
of ten thousand Gaussians costs two small matrix products on the grid and a hundred products a point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.sparse import csr_array
from torch import Tensor
from torch.autograd.function import once_differentiable

Array = np.ndarray

STENCIL = 10
"""Nodes along each axis that a value between them is made of."""


@dataclass(frozen=True)
class GridAxis:
    """Even nodes along one axis of the map.

    Attributes:
        first: Place of the first node [uv units].
        step: Distance between nodes [uv units].
        count: Number of nodes.
        closed: The node after the last is the first again.
    """

    first: float
    step: float
    count: int
    closed: bool

    @property
    def nodes(self) -> Float[Array, " node"]:
        """Places of the nodes [uv units]."""
        return self.first + self.step * np.arange(self.count)


def grid_axis(low: float, high: float, step: float, closed: bool) -> GridAxis:
    """Nodes for points between two ends.

    Args:
        low: Lower end [uv units].
        high: Upper end; one period above the lower one where the axis is closed.
        step: Largest distance between nodes [uv units].
        closed: The axis closes on itself; else nodes stand beyond both ends, as many as a value needs.
    """
    cells = max(1, math.ceil((high - low) / step))
    step = (high - low) / cells
    if closed:
        return GridAxis(low, step, cells, True)
    beyond = STENCIL // 2
    return GridAxis(low - beyond * step, step, cells + 2 * beyond, False)


class Sampler:
    """The interpolation from a grid to points, and its transpose.

    Args:
        points: Points of the map; along an axis that is not closed they lie between its ends.
        along_u: Nodes along u.
        along_v: Nodes along v.
    """

    def __init__(self, points: Float[Array, "point 2"], along_u: GridAxis, along_v: GridAxis) -> None:
        (at_u, weight_u), (at_v, weight_v) = (
            _stencil(points[:, axis], nodes) for axis, nodes in enumerate((along_u, along_v))
        )
        columns = at_u[:, :, None] * along_v.count + at_v[:, None, :]
        weights = weight_u[:, :, None] * weight_v[:, None, :]
        starts = np.arange(len(points) + 1) * STENCIL**2
        shape = (len(points), along_u.count * along_v.count)
        self._matrix = csr_array((weights.ravel(), columns.ravel(), starts), shape=shape)
        self._transpose = self._matrix.T.tocsr()

    def __call__(self, grid: Float[Tensor, "u v"]) -> Float[Tensor, " point"]:
        """Values at the points of a function known on the grid."""
        return _Sample.apply(grid, self._matrix, self._transpose)


class _Sample(torch.autograd.Function):
    """(values on the grid) -> values at the points."""

    @staticmethod
    def forward(ctx: Any, grid: Tensor, matrix: csr_array, transpose: csr_array) -> Tensor:
        ctx.transpose, ctx.shape = transpose, grid.shape
        return torch.from_numpy(matrix @ grid.detach().numpy().ravel())

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grad_outputs: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        return torch.from_numpy(ctx.transpose @ grad_outputs[0].numpy()).reshape(ctx.shape), None, None


def _stencil(
    coordinate: Float[Array, " point"], nodes: GridAxis
) -> tuple[Int[Array, "point node"], Float[Array, "point node"]]:
    """Nodes that the value at each point is made of, and Lagrange's weights of them."""
    place = (coordinate - nodes.first) / nodes.step
    low = np.floor(place).astype(np.int64) - (STENCIL // 2 - 1)
    if not nodes.closed:
        low = np.clip(low, 0, nodes.count - STENCIL)
    offset = (place - low)[:, None] - np.arange(STENCIL)
    weights = np.stack(
        [
            np.prod(np.delete(offset, k, axis=1) / np.delete(k - np.arange(STENCIL), k), axis=1)
            for k in range(STENCIL)
        ],
        axis=1,
    )
    at = low[:, None] + np.arange(STENCIL)
    return (at % nodes.count if nodes.closed else at), weights
