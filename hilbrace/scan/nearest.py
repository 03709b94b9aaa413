"""The nearest place of a surface to each of many points."""

from __future__ import annotations

from dataclasses import dataclass

import igl
import numpy as np
from jaxtyping import Bool, Float, Int

Array = np.ndarray

_ON_EDGE = 1e-6


@dataclass(frozen=True)
class Nearest:
    """Nearest places of a surface.

    Attributes:
        distance: Distance to each [m].
        place: The places.
        corner: Vertices of the triangle that each lies in.
        share: Barycentric coordinates there.
        normal: Unit normal, interpolated between the vertices.
        beyond: True where the place lies on the border of the surface, so that the point may belong to what
            lies beyond.
    """

    distance: Float[Array, " point"]
    place: Float[Array, "point 3"]
    corner: Int[Array, "point 3"]
    share: Float[Array, "point 3"]
    normal: Float[Array, "point 3"]
    beyond: Bool[Array, " point"]


def nearest(
    points: Float[Array, "point 3"],
    vertices: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
) -> Nearest:
    """Find them.

    Args:
        points: Points.
        vertices: Vertices of the surface.
        triangles: Its triangles.
    """
    squared, face, place = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), np.ascontiguousarray(vertices), triangles
    )
    corner = triangles[np.asarray(face)]
    place = np.ascontiguousarray(place)
    a, b, c = (np.ascontiguousarray(vertices[corner[:, k]]) for k in range(3))
    share = np.asarray(igl.barycentric_coordinates(place, a, b, c))
    normal = np.einsum("pk,pki->pi", share, vertex_normals(vertices, triangles)[corner])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    on_border = border_vertices(triangles, len(vertices))[corner] & (share > _ON_EDGE)
    return Nearest(
        np.sqrt(np.asarray(squared)), place, corner, share, normal, np.asarray(on_border.any(axis=1))
    )


def vertex_normals(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "vertex 3"]:
    """Unit normals at the vertices."""
    return np.asarray(igl.per_vertex_normals(np.ascontiguousarray(vertices), triangles))


def border_vertices(triangles: Int[Array, "triangle 3"], count: int) -> Bool[Array, " vertex"]:
    """Vertices on the border of a surface.

    Args:
        triangles: Its triangles.
        count: Number of its vertices.
    """
    border = np.zeros(count, dtype=bool)
    for loop in igl.boundary_loop_all(np.ascontiguousarray(triangles)):
        border[loop] = True
    return border
