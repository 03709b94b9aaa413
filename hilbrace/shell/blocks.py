"""Products of tall matrices on one thread.

BLAS starts threads of its own for large products. Where shapes are solved side by side these would compete
with the threads that solve them, for the same processors (measured on two: a gradient took 2.4 times the
processor time), and the sums would depend on how many there are. In small blocks neither happens, at no cost.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

Array = np.ndarray

_BY_MATRIX, _BY_VECTOR = 200_000, 9_000
"""Multiplications in a block, below those from which OpenBLAS uses threads (65 536 * 4 and 2 304 * 4)."""


def times(left: Float[Array, "row inner"], right: Float[Array, "inner column"]) -> Float[Array, "row column"]:
    """``left @ right`` for a tall left matrix."""
    out = np.empty((left.shape[0], right.shape[1]))
    for part in _parts(len(left), *right.shape):
        np.matmul(left[part], right, out=out[part])
    return out


def transposed_times(
    left: Float[Array, "row one"], right: Float[Array, "row other"]
) -> Float[Array, "one other"]:
    """``left.T @ right`` for two tall matrices."""
    out = np.zeros((left.shape[1], right.shape[1]))
    for part in _parts(len(left), *out.shape):
        out += left[part].T @ right[part]
    return out


def _parts(rows: int, one: int, other: int) -> Iterator[slice]:
    """Slices of rows, for products that take one x other multiplications in each row."""
    limit = _BY_VECTOR if 1 in (one, other) else _BY_MATRIX
    step = max(1, limit // max(1, one * other))
    return (slice(first, first + step) for first in range(0, rows, step))
