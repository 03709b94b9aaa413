"""Normals and areas of triangles, and normals at vertices."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

Array = np.ndarray


def face_normals(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[Float[Array, "triangle 3"], Float[Array, " triangle"]]:
    """Unit normals and areas [mm^2] of triangles."""
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    return normal / np.maximum(length, 1e-300)[:, None], 0.5 * length


def vertex_normals(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "vertex 3"]:
    """Unit normals at vertices: those of the triangles around them, by area."""
    normals, areas = face_normals(vertices, triangles)
    weights = np.repeat(areas, 3)[:, None] * np.repeat(normals, 3, axis=0)
    corners = triangles.reshape(-1)
    summed = np.stack([np.bincount(corners, weights[:, i], len(vertices)) for i in range(3)], axis=1)
    return summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), 1e-300)
