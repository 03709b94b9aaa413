"""How the skin follows the bones: smoothed weights, and dual-quaternion or linear skinning.

Linear blending of raw weights folds the skin behind a bent knee, and the strain there would rule the
design. Weights diffused over some centimetres, blended as dual quaternions, keep it whole to 110 degrees.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import igl
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float, Int
from scipy.sparse.linalg import splu

from hilbrace.body import quaternions
from hilbrace.body.body import Body
from hilbrace.errors import GeometryError

Array = np.ndarray

RINGS = 3
"""Rings of triangles kept around the bound points, so that the rim of the patch does not show inside."""
SUBDIVISIONS = 2
OTHER_LEG = {
    side: tuple(f"{bone}_{other}" for bone in ("femur", "tibia", "calcn", "toes"))
    for side, other in (("r", "l"), ("l", "r"))
}
LEAST_AREA = 1e-14
"""Twice the area below which a triangle counts as without area [m^2]."""


def smoothed_weights(
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    weights: Float[Array, "vertex bone"],
    length: float,
) -> Float[Array, "vertex bone"]:
    """Weights after one implicit step of diffusion over the surface: (M - h^2 L)^-1 M W.

    Args:
        vertices: Skin [m].
        triangles: Its triangles.
        weights: Weights to smooth [-].
        length: Diffusion length h [m]; zero returns the weights as they are.

    Returns:
        Weights of the same bones: not negative, rows summing to one.

    Raises:
        GeometryError: The skin has triangles without area, so that the step has no answer.
    """
    if length == 0.0:
        return weights / weights.sum(axis=1, keepdims=True)
    if np.min(igl.doublearea(vertices, triangles)) <= LEAST_AREA:
        raise GeometryError(
            "weights cannot be smoothed", where="skin", hint="remove triangles without area from the skin"
        )
    stiffness = igl.cotmatrix(vertices, triangles)
    mass = igl.massmatrix(vertices, triangles, igl.MASSMATRIX_TYPE_VORONOI)
    spread = splu(sparse.csc_matrix(mass - length**2 * stiffness)).solve(mass @ weights)
    spread = np.clip(spread, 0.0, None)
    return spread / spread.sum(axis=1, keepdims=True)


def bind(points: Float[Array, "point 3"], body: Body) -> Float[Array, "point bone"]:
    """Skinning weights of points on or near the skin in the neutral pose.

    The skin around the points and its weights are subdivided by Loop's rule before the weights are read at
    the closest place: linear interpolation in the coarse triangles would leave kinks in the strain.

    Args:
        points: Points in the neutral pose [m], in the frame of ``body.vertices``.
        body: The body that they follow.

    Returns:
        Weights in the order of ``body.bones``; rows sum to one.
    """
    vertices, triangles, weights = _fine_patch(points, body)
    _, nearest, closest = igl.point_mesh_squared_distance(points, vertices, triangles)
    corners = triangles[np.asarray(nearest)]
    shares = igl.barycentric_coordinates(closest, *(np.ascontiguousarray(vertices[c]) for c in corners.T))
    blended = np.einsum("pk,pkb->pb", np.clip(shares, 0.0, None), weights[corners])
    return blended / blended.sum(axis=1, keepdims=True)


def one_leg(body: Body, side: str) -> Body:
    """The body without the skin of the other leg.

    Thighs and calves of heavy legs touch in the neutral pose; points of one must not hang on the other.

    Args:
        body: A body.
        side: Leg to keep, ``"r"`` or ``"l"``.
    """
    other = [k for k, bone in enumerate(body.bones) if bone in OTHER_LEG[side]]
    theirs = body.bone_weights[:, other].sum(axis=1) > 0.5
    return replace(body, triangles=body.triangles[~theirs[body.triangles].any(axis=1)])


def skin(
    points: Float[Array, "point 3"],
    weights: Float[Array, "point bone"],
    rotations: Float[Array, "frame bone 3 3"],
    translations: Float[Array, "frame bone 3"],
) -> Float[Array, "frame point 3"]:
    """Points carried by the bones, blended as dual quaternions.

    Args:
        points: Points at rest [m].
        weights: Weights; rows sum to one.
        rotations: Rotation of each bone against rest, x -> R x + t.
        translations: Translation of each bone [m].

    Returns:
        Points in each frame [m].
    """
    real = quaternions.from_matrices(rotations)
    dual = quaternions.dual_parts(real, translations)
    both = np.concatenate([real, dual], axis=-1)
    blend = np.empty((len(rotations), len(points), 8))
    chief = weights.argmax(axis=1)
    for bone in np.unique(chief):
        led = chief == bone
        sign = np.where((real @ real[:, bone, :, None])[..., 0] < 0.0, -1.0, 1.0)
        blend[:, led] = weights[led] @ (sign[..., None] * both)
    return quaternions.move(blend[..., :4], blend[..., 4:], points)


def linear_skin(
    points: Float[Array, "point 3"],
    weights: Float[Array, "point bone"],
    rotations: Float[Array, "frame bone 3 3"],
    translations: Float[Array, "frame bone 3"],
) -> Float[Array, "frame point 3"]:
    """Points carried by the bones, blended linearly: each is the weighted mean of where its bones take it.

    Arguments and result are those of `skin`. The result is linear in the bones' matrices; the limb loses
    volume where it bends.
    """
    ones = np.ones((len(points), 1))
    operator = weights[:, :, None] * np.concatenate([points, ones], axis=1)[:, None, :]
    matrices = np.concatenate([rotations, translations[..., None]], axis=-1)
    flat = np.moveaxis(matrices, 2, 3).reshape(len(rotations), -1, 3)
    return operator.reshape(len(points), -1) @ flat


SKINNINGS: dict[str, Callable[..., Float[Array, "frame point 3"]]] = {
    "dual_quaternion": skin,
    "linear": linear_skin,
}
"""Ways to blend the bones' motions, by their names in the configuration (``body.skinning``)."""


def _fine_patch(points: Float[Array, "point 3"], body: Body) -> tuple[Array, Array, Array]:
    """Subdivided skin around the points, with its weights."""
    triangles = np.ascontiguousarray(body.triangles)
    _, nearest, _ = igl.point_mesh_squared_distance(points, body.vertices, triangles)
    near = np.zeros(len(body.vertices), bool)
    near[triangles[np.asarray(nearest)]] = True
    for _ in range(RINGS):
        near[triangles[near[triangles].any(axis=1)]] = True
    patch = triangles[near[triangles].all(axis=1)]
    kept = np.unique(patch)
    new = np.full(len(body.vertices), -1)
    new[kept] = np.arange(len(kept))
    patch = new[patch]
    vertices, weights = body.vertices[kept], body.bone_weights[kept]
    for _ in range(SUBDIVISIONS):
        rule, patch = igl.loop_matrix(patch, len(vertices))
        vertices, weights = rule @ vertices, rule @ weights
    return np.ascontiguousarray(vertices), np.ascontiguousarray(patch), weights
