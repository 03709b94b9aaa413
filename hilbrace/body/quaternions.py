"""Unit quaternions and unit dual quaternions in plain arrays; scalar part last."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

Array = np.ndarray


def from_matrices(rotations: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 4"]:
    """Unit quaternions (x, y, z, w) of rotation matrices; the sign of each is arbitrary."""
    flat = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat()
    return flat.reshape(*rotations.shape[:-2], 4)


def product(left: Float[Array, "*batch 4"], right: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """Hamilton product: first ``right``, then ``left``."""
    a, b = left[..., :3], right[..., :3]
    s, t = left[..., 3:], right[..., 3:]
    vector = s * b + t * a + np.cross(a, b)
    return np.concatenate([vector, s * t - (a * b).sum(axis=-1, keepdims=True)], axis=-1)


def dual_parts(
    real: Float[Array, "*batch 4"], translations: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 4"]:
    """Dual part of the rigid motion x -> R x + t: half the product of t and the rotation."""
    pure = np.concatenate([translations, np.zeros_like(translations[..., :1])], axis=-1)
    return 0.5 * product(pure, real)


def move(
    real: Float[Array, "frame point 4"], dual: Float[Array, "frame point 4"], points: Float[Array, "point 3"]
) -> Float[Array, "frame point 3"]:
    """Points moved by (unnormalised) dual quaternions.

    Args:
        real: Real parts; their norm divides out.
        dual: Dual parts.
        points: Points at rest.

    Returns:
        Moved points, by the closed form of Kavan, Collins, Zara, O'Sullivan, "Geometric skinning with
        approximate dual quaternion blending", ACM TOG 27(4), 2008, Alg. 1.
    """
    norm = np.linalg.norm(real, axis=-1, keepdims=True)
    vector, scalar = real[..., :3] / norm, real[..., 3:] / norm
    dual_vector, dual_scalar = dual[..., :3] / norm, dual[..., 3:] / norm
    turned = points + 2.0 * np.cross(vector, np.cross(vector, points) + scalar * points)
    shift = scalar * dual_vector - dual_scalar * vector + np.cross(vector, dual_vector)
    return turned + 2.0 * shift
