"""Self-tuning spectral clustering into two groups (Zelnik-Manor & Perona 2004, NIPS 17).

Each sample measures distances in its own scale, the distance to its seventh neighbour, so that dense and
thin groups are treated alike. The two leading eigenvectors of the normalised affinity are turned until every
row lies as nearly along one of the axes as it can; that axis is the sample's group. No starting point is
drawn, so the groups are the same every time.

The affinities of all pairs are kept, as in the publication. A field on a fine mesh goes through its
quantiles: among ten thousand scattered samples of one number some chance gap is always wider than the local
scales bridge, and would be found as a cluster.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar
from scipy.spatial.distance import cdist

Array = np.ndarray

SCALE_NEIGHBOUR = 7
"""Neighbour whose distance is a sample's own scale; the value of the publication."""
QUANTILES = 512
"""Samples that stand for a field."""
_ANGLES = 64


def field_memberships(
    values: Float[Array, " sample"], weights: Float[Array, " sample"]
) -> Float[Array, " sample"]:
    """Split a field of one number into low and high values.

    Args:
        values: The field, finite and not the same everywhere.
        weights: Area of each value.

    Returns:
        Negative where low, positive where high; near 0 for a value between both groups, 1 for a sure one.
    """
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order])
    levels = (np.arange(QUANTILES) + 0.5) / QUANTILES * share[-1]
    sample = np.unique(np.interp(levels, share - 0.5 * weights[order], values[order]))
    membership = memberships(sample[:, None])
    if membership[-1] < membership[0]:
        membership = -membership
    return np.interp(values, sample, membership)


def memberships(samples: Float[Array, "sample feature"]) -> Float[Array, " sample"]:
    """Split samples into two groups.

    Args:
        samples: Features, all in one unit; a few thousand samples at most.

    Returns:
        Group of each sample by sign, which has no meaning by itself, and how surely it is in it: 1 for a row
        of the turned eigenvectors along an axis, near 0 for one between both.
    """
    turned, _ = aligned(leading_vectors(self_tuned_affinity(samples)))
    first, second = (turned**2).T
    return (first - second) / np.maximum(first + second, 1e-300)


def self_tuned_affinity(samples: Float[Array, "sample feature"]) -> Float[Array, "sample sample"]:
    """Affinity ``exp(-d_ij^2 / (s_i s_j))`` with each sample's local scale s, none to itself (Eq. 1)."""
    distance = cdist(samples, samples)
    scale = np.sort(distance, axis=1)[:, min(SCALE_NEIGHBOUR, len(samples) - 1)]
    scale = np.maximum(scale, 1e-9 * max(float(distance.max()), 1e-300))
    affinity = np.exp(-(distance**2) / np.outer(scale, scale))
    np.fill_diagonal(affinity, 0.0)
    return affinity


def leading_vectors(affinity: Float[Array, "sample sample"]) -> Float[Array, "sample 2"]:
    """The two eigenvectors of ``D^-1/2 A D^-1/2`` with the largest eigenvalues, the largest first."""
    root = 1.0 / np.sqrt(np.maximum(affinity.sum(axis=1), 1e-300))
    count = len(affinity)
    _, vectors = eigh(root[:, None] * affinity * root, subset_by_index=(count - 2, count - 1))
    return vectors[:, ::-1]


def aligned(vectors: Float[Array, "sample 2"]) -> tuple[Float[Array, "sample 2"], float]:
    """Eigenvectors turned in their plane so that each row lies nearly along one axis.

    Minimises ``sum_ij Z_ij^2 / max_j Z_ij^2`` (Eq. 3) over the one angle that two vectors have.

    Returns:
        The turned vectors, and the cost per sample: 1 if every row lies on an axis, at most 2.
    """

    def turned(angle: float) -> Float[Array, "sample 2"]:
        c, s = np.cos(angle), np.sin(angle)
        return vectors @ np.array([[c, -s], [s, c]])

    def cost(angle: float) -> float:
        squares = turned(angle) ** 2
        largest = np.maximum(squares.max(axis=1), 1e-300)
        return float((squares.sum(axis=1) / largest).mean())

    angles = np.linspace(0.0, np.pi / 2, _ANGLES, endpoint=False)
    near = angles[int(np.argmin([cost(angle) for angle in angles]))]
    step = angles[1]
    best = minimize_scalar(cost, bounds=(near - step, near + step), method="bounded", options={"xatol": 1e-9})
    return turned(float(best.x)), float(best.fun)
