"""Gaps of cluster markers: filled where the cluster or the neighbouring frames tell the place, else left.

Nothing else is ever filled: a frame whose place is not known stays NaN, and the angles there too.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from evaluation.rigid_fit import fit_rigid
from hilbrace.motion.filters import gap_free_runs

Array = np.ndarray

SUPPORT = 12
"""Frames on each side of a gap that carry its spline."""


@dataclass(frozen=True)
class FilledCluster:
    """Markers of one cluster with gaps filled.

    Attributes:
        positions: Positions [m]; NaN where a gap stayed.
        by_cluster: Samples that the other markers of the cluster gave.
        by_spline: Samples that neighbouring frames gave.
        left: Samples that stayed NaN.
    """

    positions: Float[Array, "frame marker 3"]
    by_cluster: int
    by_spline: int
    left: int


def fill_cluster(
    template: Float[Array, "marker 3"], observed: Float[Array, "frame marker 3"], longest_gap: int
) -> FilledCluster:
    """Fill the gaps of a cluster: first from its other markers, then, where short, by a cubic spline.

    A hidden marker moves with the three or more others, and its place among them is taken from before and
    after the gap, so that the path has no steps.

    Args:
        template: Marker positions in the calibration [m].
        observed: Marker positions over time [m].
        longest_gap: Longest gap that a spline may bridge [frames].
    """
    missing = int(np.isnan(observed).any(axis=2).sum())
    carried = np.stack([_from_others(template, observed, k) for k in range(len(template))], axis=1)
    after_cluster = int(np.isnan(carried).any(axis=2).sum())
    filled = np.stack([bridge(carried[:, k], longest_gap) for k in range(len(template))], axis=1)
    left = int(np.isnan(filled).any(axis=2).sum())
    return FilledCluster(filled, missing - after_cluster, after_cluster - left, left)


def _from_others(
    template: Float[Array, "marker 3"], observed: Float[Array, "frame marker 3"], k: int
) -> Float[Array, "frame 3"]:
    path = observed[:, k].copy()
    hidden = np.isnan(path).any(axis=1)
    if not hidden.any():
        return path
    weights = np.ones(len(template))
    weights[k] = 0.0
    fit = fit_rigid(template, observed, weights)
    local = np.einsum("fji,fj->fi", fit.rotation, path - fit.translation)
    known = np.flatnonzero(np.isfinite(local).all(axis=1))
    frames = np.arange(len(path))
    place = (
        np.column_stack([np.interp(frames, known, local[known, axis]) for axis in range(3)])
        if len(known)
        else np.broadcast_to(template[k], path.shape)
    )
    path[hidden] = (np.einsum("fij,fj->fi", fit.rotation, place) + fit.translation)[hidden]
    return path


def bridge(path: Float[Array, "frame 3"], longest_gap: int) -> Float[Array, "frame 3"]:
    """Fill the gaps inside a path that are short enough with a cubic spline.

    Args:
        path: Positions over time [m].
        longest_gap: Longest gap to fill [frames].
    """
    filled = path.copy()
    runs = gap_free_runs(path.sum(axis=1))
    for before, after in pairwise(runs):
        if after.start - before.stop > longest_gap:
            continue
        support = np.r_[
            max(before.start, before.stop - SUPPORT) : before.stop,
            after.start : min(after.stop, after.start + SUPPORT),
        ]
        gap = np.arange(before.stop, after.start)
        filled[gap] = CubicSpline(support, path[support])(gap)
    return filled
