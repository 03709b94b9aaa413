"""A field written by a network of several layers, as the paper says its own can be extended (Sec. 6).

The coordinates enter as waves: ``cos`` and ``sin`` of whole multiples, the k-th over k so that a fresh
network is smooth. Around a closed sleeve they are the waves of the period, and whatever the network does with
them closes there. The layers between are ``tanh``.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float

from hilbrace.field.gaussian import check_points

Array = np.ndarray

STEP = 0.03
"""A weight of the network for one unit of its parameter [-]. A learning rate that suits the Gaussians, whose
parameters are of order one, then suits the network."""


class NetworkField:
    """A fully connected network over the flat map, prepared for one set of points; a `protocol.Field`.

    Args:
        points_uv: Points of the flat map, in the unit square.
        layers: Neurons of the hidden layers.
        waves: Waves along each axis.
        period_u: Width of the map around the limb [uv units] where the field must close on itself; 0 for a
            map that is cut.

    Attributes:
        parameters: Number of free parameters.

    Raises:
        GeometryError: A point lies outside the unit square.
    """

    def __init__(
        self,
        points_uv: Float[Array, "point 2"],
        layers: tuple[int, ...],
        waves: int,
        period_u: float = 0.0,
    ) -> None:
        points = np.asarray(points_uv, dtype=np.float64)
        check_points(points, period_u)
        turn = 2.0 * np.pi / period_u if period_u else np.pi
        features = [_waves(points[:, 0], turn, waves), _waves(points[:, 1], np.pi, waves)]
        self._features = torch.from_numpy(np.concatenate(features, axis=1))
        self._widths = (self._features.shape[1], *layers, 1)
        self.parameters = sum((n + 1) * m for n, m in pairwise(self._widths))

    def start(self, seed: int, spread: float) -> Float[torch.Tensor, " parameter"]:
        """Parameters of a nearly even field: normal weights by the width of each layer, no offsets.

        Args:
            seed: Seed of the weights.
            spread: Standard deviation of the field, about [-]; the last layer is scaled down to it.
        """
        generator = np.random.default_rng(seed)
        parts = []
        for layer, (n, m) in enumerate(pairwise(self._widths)):
            size = spread if layer == len(self._widths) - 2 else 1.0
            weights = generator.standard_normal((m, n)) * (size / math.sqrt(n))
            parts += [weights.ravel(), np.zeros(m)]
        return torch.from_numpy(np.concatenate(parts) / STEP)

    def logits(
        self, theta: Float[torch.Tensor, " parameter"], contrast: float = 10.0
    ) -> Float[torch.Tensor, " point"]:
        """``contrast`` times the network's output at the points.

        Args:
            theta: Weights and offsets of all layers in order, flat, in units of `STEP`.
            contrast: Factor of the output [-].
        """
        at, values, last = 0, self._features, len(self._widths) - 2
        for layer, (n, m) in enumerate(pairwise(self._widths)):
            weights = STEP * theta[at : at + n * m].reshape(m, n)
            offset = STEP * theta[at + n * m : at + (n + 1) * m]
            values = torch.addmm(offset, values, weights.T)
            values = values if layer == last else torch.tanh(values)
            at += (n + 1) * m
        return contrast * values[:, 0]


def _waves(coordinate: Float[Array, " point"], turn: float, waves: int) -> Float[Array, "point feature"]:
    """``cos(k turn x) / k`` and ``sin(k turn x) / k`` for k from 1 [-]."""
    count = np.arange(1, waves + 1)
    phase = turn * coordinate[:, None] * count
    return np.concatenate([np.cos(phase) / count, np.sin(phase) / count], axis=1)
