"""How each triangle of the skin is stretched by the motion."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from hilbrace.domain.isoline import mesh_edges
from hilbrace.errors import GeometryError

Array = np.ndarray

COLLAPSED = 0.01
"""Area ratio below which a triangle counts as collapsed [-]."""


def local_edges(
    points: Float[Array, "*frame vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "*frame triangle 2 2"]:
    """Edges 0-1 and 0-2 of each triangle as the columns of a matrix, in the triangle's own axes.

    The first axis runs along edge 0-1, the second lies in the triangle on the side of vertex 2.
    """
    corner = points[..., triangles, :]
    first, second = corner[..., 1, :] - corner[..., 0, :], corner[..., 2, :] - corner[..., 0, :]
    length = np.linalg.norm(first, axis=-1)
    along = (first * second).sum(axis=-1) / length
    across = np.linalg.norm(np.cross(first, second), axis=-1) / length
    matrix = np.zeros((*length.shape, 2, 2))
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1] = length, along, across
    return matrix


def deformation_gradients(
    rest: Float[Array, "vertex 3"],
    posed: Float[Array, "frame vertex 3"],
    triangles: Int[Array, "triangle 3"],
) -> Float[Array, "frame triangle 2 2"]:
    """Deformation gradient of each triangle, rest to posed, between the triangles' own axes [-].

    ``G = D_posed D_rest^-1`` with the edge matrices of `local_edges`; upper triangular, since the first
    axis follows edge 0-1. Its determinant is the area ratio, ``G^T G`` the right Cauchy-Green tensor.
    """
    return local_edges(posed, triangles) @ np.linalg.inv(local_edges(rest, triangles))


def folded(
    rest: Float[Array, "vertex 3"],
    posed: Float[Array, "frame vertex 3"],
    triangles: Int[Array, "triangle 3"],
) -> Bool[Array, "frame triangle"]:
    """Triangles that the motion folds over one of their neighbours.

    In its own axes a triangle never turns over, so a fold shows between neighbours only: their normals,
    less than 90 deg apart at rest, are more than 120 deg apart.
    """
    _, edge_of = mesh_edges(triangles)
    order = np.argsort(edge_of.ravel(), kind="stable")
    edge = edge_of.ravel()[order]
    inner = np.flatnonzero(edge[1:] == edge[:-1])
    one, two = order[inner] // 3, order[inner + 1] // 3
    flat = _cosine(rest, triangles, one, two) > 0.0
    found = np.zeros((len(posed), len(triangles)), bool)
    for frame, points in enumerate(posed):
        over = flat & (_cosine(points, triangles, one, two) < -0.5)
        found[frame, one[over]] = True
        found[frame, two[over]] = True
    return found


def check_deformation(
    gradients: Float[Array, "frame triangle 2 2"], time: Float[Array, " frame"]
) -> Float[Array, "frame triangle"]:
    """Area ratios of the triangles [-].

    Raises:
        GeometryError: A triangle shrinks to nothing in some frame; names the worst one.
    """
    ratio = gradients[..., 0, 0] * gradients[..., 1, 1] - gradients[..., 0, 1] * gradients[..., 1, 0]
    small = ~(ratio >= COLLAPSED)
    if small.any():
        frame = int(np.argmax(small.sum(axis=1)))
        raise GeometryError(
            f"{int(small[frame].sum())} triangles of the skin shrink below {COLLAPSED:.0%} of their area",
            where=f"design domain at {time[frame]:.3f} s",
            hint="raise body.weight_smoothing_mm, or check the joint angles of that instant",
        )
    return ratio


def _cosine(
    points: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
    one: Int[Array, " pair"],
    two: Int[Array, " pair"],
) -> Float[Array, " pair"]:
    corner = points[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return (normal[one] * normal[two]).sum(axis=1)
