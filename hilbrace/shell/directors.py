"""Averaged nodal directors of a triangle mesh and the tangents that carry the nodal rotations.

The director of a vertex is the angle-weighted mean of the unit normals around it. A shell with one director
per vertex has five degrees of freedom there, three translations and two rotations about the tangents of the
director, and needs no drilling stiffness (Lee & Bathe 2004, Computers & Structures 82:945-962).
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from hilbrace.errors import GeometryError

Array = np.ndarray

_STEEPEST = 0.2
"""Least cosine between a triangle's normal and the director of a corner: 78 degrees, a crease."""


def triangle_normals(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> tuple[Float[Array, "triangle 3"], Float[Array, " triangle"]]:
    """Unit normals [-] and areas [mm^2] of the triangles.

    Raises:
        GeometryError: A triangle has no area.
    """
    corners = vertices[triangles]
    edges = corners[:, 1:] - corners[:, :1]
    cross = np.cross(edges[:, 0], edges[:, 1])
    twice_area = np.linalg.norm(cross, axis=1)
    flat = np.flatnonzero(~(twice_area > 1e-12 * (edges**2).sum(axis=(1, 2))))
    if flat.size:
        raise GeometryError(
            f"{flat.size} triangles have no area",
            where=f"triangle {flat[0]} of the shell",
            hint="remesh the surface, or weld its doubled vertices",
        )
    return cross / twice_area[:, None], 0.5 * twice_area


def nodal_directors(
    vertices: Float[Array, "vertex 3"], triangles: Int[Array, "triangle 3"]
) -> Float[Array, "vertex 3"]:
    """Unit directors [-]: angle-weighted means of the normals of the triangles around each vertex.

    Raises:
        GeometryError: A triangle has no area, or stands so steep to the director of a corner that this
            means nothing (a fold, a crease, or triangles of mixed orientation).
    """
    normals, _ = triangle_normals(vertices, triangles)
    corners = vertices[triangles]
    to_next = np.roll(corners, -1, axis=1) - corners
    to_last = np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(to_next, to_last), axis=-1)
    angle = np.arctan2(sine, (to_next * to_last).sum(axis=-1))
    total = np.zeros_like(vertices)
    np.add.at(total, triangles, angle[..., None] * normals[:, None, :])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    directors = total / np.where(length > 0, length, 1.0)
    _refuse_folds(normals, directors, triangles)
    return directors


def tangent_basis(directors: Float[Array, "*node 3"]) -> Float[Array, "*node 2 3"]:
    """Two unit tangents [-] of each director, right-handed with it; the axes of the nodal rotations."""
    steep = np.abs(directors[..., :1]) < 0.9
    helper = np.where(steep, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    first = np.cross(helper, directors)
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, np.cross(directors, first)], axis=-2)


def _refuse_folds(
    normals: Float[Array, "triangle 3"],
    directors: Float[Array, "vertex 3"],
    triangles: Int[Array, "triangle 3"],
) -> None:
    cosine = np.einsum("ec,eic->ei", normals, directors[triangles]).min(axis=1)
    folded = np.flatnonzero(~(cosine > _STEEPEST))
    if folded.size:
        raise GeometryError(
            f"{folded.size} triangles stand steeper than 78 degrees to the mean normal of a corner",
            where=f"triangle {folded[0]} of the shell",
            hint="orient all triangles outwards, and smooth folds and sharp creases of the surface",
        )
