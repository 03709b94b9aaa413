"""A limb guessed from the inner face of the sleeve that was made on it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array, eye_array
from scipy.sparse.linalg import spsolve

from fabrication.foreign_brace import Mesh
from fabrication.halving import refined
from fabrication.sleeve_axis import Span
from hilbrace.errors import GeometryError

Array = np.ndarray

_FACING = 0.7
_SMOOTHINGS = 20
_GRID = 1.25
"""Spacing of a guessed limb's mesh, in resolutions [-]."""


def guessed_limb(brace: Mesh, span: Span, resolution_mm: float, where: str) -> Mesh:
    """A tube along the brace's inner face, stretched over its windows like a skin.

    Args:
        brace: The brace [mm].
        span: Where it begins and ends.
        resolution_mm: Spacing of what is looked at.
        where: The brace's file.

    Raises:
        GeometryError: Seen from its axis the brace hides parts of its own inner face.
    """
    step = _GRID * resolution_mm
    local = span.local(brace.vertices)
    p = local[brace.triangles]
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    middle = p.mean(axis=1)
    radial = middle[:, :2] / np.linalg.norm(middle[:, :2], axis=1, keepdims=True)
    inner = np.einsum("tx,tx->t", normal[:, :2], radial) < -_FACING
    used, triangles = np.unique(brace.triangles[inner], return_inverse=True)
    samples, _, _ = refined(local[used], local[used], triangles.reshape(-1, 3), step)
    around = int(np.ceil(2 * np.pi * np.median(np.linalg.norm(samples[:, :2], axis=1)) / step))
    along = max(2, int(np.ceil((span.high.max() - span.low) / step)))
    turn = np.arange(around) / around * 2 * np.pi
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    top = span.upper(circle)
    part = (samples[:, 2] - span.low) / (span.upper(samples) - span.low)
    radius = _stretched(samples, part, around, along, where)
    height = span.low + np.arange(along + 1) / along * (top - span.low)[:, None]
    grid = np.concatenate([radius[..., None] * circle[:, None], height[..., None]], axis=-1)
    i, j = np.meshgrid(np.arange(around), np.arange(along), indexing="ij")
    right = (i + 1) % around
    a, b, c, d = (k * (along + 1) + m for k, m in ((i, j), (right, j), (right, j + 1), (i, j + 1)))
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    return Mesh(grid.reshape(-1, 3) @ span.axes + span.centre, triangles)


def _stretched(
    samples: Float[Array, "sample 3"], part: Float[Array, " sample"], around: int, along: int, where: str
) -> Float[Array, "around row"]:
    """Radius of a skin over samples of the inner face, by angle and part of the height."""
    radius = np.linalg.norm(samples[:, :2], axis=1)
    i = np.round(np.arctan2(samples[:, 1], samples[:, 0]) / (2 * np.pi) * around).astype(int) % around
    j = np.clip(np.round(part * along).astype(int), 0, along)
    cell, size = i * (along + 1) + j, around * (along + 1)
    count, total = np.bincount(cell, minlength=size), np.bincount(cell, radius, minlength=size)
    least, most = np.full(size, np.inf), np.zeros(size)
    np.minimum.at(least, cell, radius)
    np.maximum.at(most, cell, radius)
    known = count > 0
    folded = known & (most > 1.3 * least)
    if folded.mean() > 0.01 or known.mean() < 0.05:
        raise GeometryError(
            "the limb cannot be guessed from the brace: its inner face is no simple tube around a line",
            where=where,
            hint="give the limb with --limb",
        )
    step = np.arange(size).reshape(around, along + 1)
    pairs = np.concatenate(
        [
            np.stack([step, np.roll(step, -1, axis=0)], -1).reshape(-1, 2),
            np.stack([step[:, :-1], step[:, 1:]], -1).reshape(-1, 2),
        ]
    )
    both = np.concatenate([pairs, pairs[:, ::-1]])
    degree = np.bincount(both[:, 0], minlength=size)
    mean = csr_array((1.0 / degree[both[:, 0]], (both[:, 0], both[:, 1])), shape=(size, size))
    value = np.zeros(size)
    value[known] = total[known] / count[known]
    free = np.flatnonzero(~known)
    if len(free):
        rows = mean[free]
        matrix = eye_array(len(free)) - rows[:, free]
        value[free] = np.asarray(spsolve(matrix.tocsc(), rows @ value))
    for _ in range(_SMOOTHINGS):
        value = (value + mean @ value) / 2
    return value.reshape(around, along + 1)
