"""How thin a body is anywhere: rays from its faces through it to the face on the other side."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from manifold3d import Manifold

from fabrication.bodies import mesh_of

Array = np.ndarray

RAYS = 20000
"""Rays shot through one body."""

OPPOSITE = -0.8
"""Cosine between two faces that bound one wall; two faces that meet in an edge are no wall."""

START_MM = 1e-4
"""How far inside the face a ray starts [mm]."""


SPECKS = 5
"""Thin places that fewer rays meet are specks: a rounded corner, the thread of a mark."""


def thinnest_wall(solid: Manifold, reach_mm: float, rays: int = RAYS) -> float:
    """Thickness of the thinnest wall that more than a few rays meet [mm]; the reach where all are thicker."""
    walls = wall_thickness(solid, reach_mm, rays)
    return float(walls[SPECKS]) if len(walls) > SPECKS else reach_mm


def wall_thickness(solid: Manifold, reach_mm: float, rays: int = RAYS) -> Float[Array, " wall"]:
    """Thickness of a body's walls where they are thinner than a reach [mm], thinnest first.

    Rays start from evenly spaced places of the surface, against the normal. What counts is a face on the
    other side that looks the other way; the slope of the far face is taken off.

    Args:
        solid: The body.
        reach_mm: Walls thicker than this are left out [mm].
        rays: How many places are looked at.
    """
    vertices, triangles = mesh_of(solid)
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(areas, 1e-300)[:, None]
    edges = np.linspace(0.0, areas.sum(), rays, endpoint=False) + 0.5 * areas.sum() / rays
    chosen = np.minimum(np.searchsorted(np.cumsum(areas), edges), len(areas) - 1)
    starts = corners[chosen].mean(axis=1) - START_MM * normals[chosen]
    ends = starts - reach_mm * normals[chosen]
    found = []
    for start, end, normal in zip(starts, ends, normals[chosen], strict=True):
        hits = solid.ray_cast(tuple(start), tuple(end))
        if hits:
            facing = float(np.dot(hits[0].normal, normal))
            if facing < OPPOSITE:
                found.append(np.linalg.norm(np.asarray(hits[0].position) - start) * -facing + START_MM)
    return np.sort(np.array(found, dtype=float))
