"""The rigid motion of a marker cluster: weighted least squares, frame by frame, with markers missing.

The rotation is the one of Kabsch (1976, Acta Cryst A32:922-923), which Soederkvist & Wedin (1993, J Biomech
26:1473-1477) brought to skeletal movement: the singular vectors of the weighted covariance, with a positive
determinant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

Array = np.ndarray

FEWEST = 3
"""Markers that a rigid fit needs."""

NARROWEST = 0.05
"""Smallest width of the visible markers over their length; below it they lie nearly on one line."""


@dataclass(frozen=True)
class RigidFit:
    """Position and orientation of a cluster over time: ``observed = rotation @ template + translation``.

    Attributes:
        rotation: Rotation from the template's axes to the laboratory's; NaN where it cannot be told.
        translation: Where the template's origin goes [m].
        residual: Weighted root mean square distance of markers and fitted template [m].
        markers: Markers that were visible and had weight.
    """

    rotation: Float[Array, "frame 3 3"]
    translation: Float[Array, "frame 3"]
    residual: Float[Array, " frame"]
    markers: Int[Array, " frame"]

    def carry(self, point: Float[Array, " 3"]) -> Float[Array, "frame 3"]:
        """Path of a point of the template [m]."""
        return self.rotation @ point + self.translation


def fit_rigid(
    template: Float[Array, "marker 3"],
    observed: Float[Array, "frame marker 3"],
    weights: Float[Array, " marker"] | None = None,
) -> RigidFit:
    """Fit a template to observed markers.

    Frames with fewer than three visible markers, or with markers on one line, give NaN.

    Args:
        template: Marker positions in the calibration [m].
        observed: Marker positions over time [m]; NaN where hidden.
        weights: Trust in each marker [-]; equal if left out.
    """
    trust = np.ones(len(template)) if weights is None else weights
    visible = np.isfinite(observed).all(axis=2) & (trust > 0)
    share = visible * trust
    total = np.maximum(share.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    known = np.where(visible[:, :, None], observed, 0.0)
    middle = (share / total) @ template
    centre = np.einsum("fm,fmi->fi", share / total, known)
    local = template[None] - middle[:, None]
    covariance = np.einsum("fm,fmi,fmj->fij", share / total, known - centre[:, None], local)
    left, _, right = np.linalg.svd(covariance)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    rotation = left @ right
    fitted = np.einsum("fij,fmj->fmi", rotation, local) + centre[:, None]
    error = ((fitted - known) ** 2).sum(axis=2)
    residual = np.sqrt((share / total * error).sum(axis=1))
    translation = centre - np.einsum("fij,fj->fi", rotation, middle)
    count = visible.sum(axis=1)
    unusable = (count < FEWEST) | ~_spread_out(template, visible)
    rotation[unusable], translation[unusable], residual[unusable] = np.nan, np.nan, np.nan
    return RigidFit(rotation, translation, residual, count)


def width_over_length(points: Float[Array, "marker 3"]) -> float:
    """Second over first principal extent of points: 0 on one line [-]."""
    if len(points) < FEWEST:
        return 0.0
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(extents[1] / extents[0]) if extents[0] > 0 else 0.0


def _spread_out(
    template: Float[Array, "marker 3"], visible: Bool[Array, "frame marker"]
) -> Bool[Array, " frame"]:
    """Whether the visible markers of each frame leave no turn about a line open."""
    patterns, pattern_of = np.unique(visible, axis=0, return_inverse=True)
    usable = np.array([width_over_length(template[pattern]) >= NARROWEST for pattern in patterns], bool)
    return usable[pattern_of.reshape(-1)]
