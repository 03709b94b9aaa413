"""The distance field of a cell on torch tensors, with gradients for the position in the map."""

from __future__ import annotations

from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor

from hilbrace.material.cells import LUT_INTERVALS, distance_table


def cell_distance_tensor(
    name: str, u: Float[Tensor, "*shape"], v: Float[Tensor, "*shape"]
) -> Float[Tensor, "*shape"]:
    """Distance field ``f_cell`` at folded coordinates, as `hilbrace.material.cells.cell_distance` gives it.

    The derivative is that of the bilinear table, within an interval of it; where the points lie in another
    place of the map it is passed on through `hilbrace.material.cells.fold`.

    Args:
        name: Name of the cell, or path of its skeleton file.
        u: First folded coordinate, in [0, 1].
        v: Second folded coordinate.

    Returns:
        Distance to the skeleton [cell sides].
    """
    table = _table(distance_table(name).tobytes(), u.dtype)
    x, y = u.clamp(0, 1) * LUT_INTERVALS, v.clamp(0, 1) * LUT_INTERVALS
    i = x.detach().long().clamp(max=LUT_INTERVALS - 1)
    j = y.detach().long().clamp(max=LUT_INTERVALS - 1)
    a, b = x - i, y - j
    low = (1 - b) * table[i, j] + b * table[i, j + 1]
    high = (1 - b) * table[i + 1, j] + b * table[i + 1, j + 1]
    return (1 - a) * low + a * high


@lru_cache(maxsize=8)
def _table(values: bytes, dtype: torch.dtype) -> Tensor:
    side = LUT_INTERVALS + 1
    return torch.frombuffer(bytearray(values), dtype=torch.float64).reshape(side, side).to(dtype)
