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
    """Unit normals at vertices: those of the triangles around them, by their angles there.

    Weights of this kind make the normal of a nearest vertex tell inside from outside, whatever the sizes of
    the triangles (Baerentzen & Aanaes 2005).
    """
    normals, _ = face_normals(vertices, triangles)
    summed = np.zeros((len(vertices), 3))
    for corner in range(3):
        at, after, before = (vertices[triangles[:, (corner + step) % 3]] for step in (0, 1, 2))
        forth, back = after - at, before - at
        angle = np.arctan2(np.linalg.norm(np.cross(forth, back), axis=1), (forth * back).sum(axis=1))
        for axis in range(3):
            weights = angle * normals[:, axis]
            summed[:, axis] += np.bincount(triangles[:, corner], weights, len(vertices))
    return summed / np.maximum(np.linalg.norm(summed, axis=1, keepdims=True), 1e-300)
